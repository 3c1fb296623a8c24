"""References of robots, their motion under control, and its recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.ndimage import gaussian_filter1d

from cablesense_base import Array
from cablesense_plants.cases import PlantError
from cablesense_plants.robot.robots import RealRobot, RobotKind, stacked, times

STEP_S = 1e-3
"""Step of the simulation and of the robots' controller."""
_STEPS_OF_PLAY = 5
"""Within one step, where teeth touch and part."""
_SWING_RAD = 0.7
"""Phase, at most, by which a joint swings on its bristles in one step."""
_TAPER = 0.16
"""Share of a trial at both ends: how long sines take to come and to go."""
_MOVE_S = 0.9
_HOLD_S = 0.5
_CURRENT_S = 0.002
"""Lag of a drive's current."""
_FILTER_S = 0.0016
"""Time constant of the filter of a torque's noise."""
_VELOCITY_S = 0.004
_STRIDE = 8
_PASSING_ROWS = 2.5
"""Rows in which a joint passes from tooth to tooth, where a cause is sized."""


class ReferenceMotion(NamedTuple):
    """References of the controllers of B robots, (T, B, N); T steps of the simulation."""

    angle: Array
    speed: Array
    acceleration: Array


def reference(kind: RobotKind, rng: np.random.Generator) -> ReferenceMotion:
    """All trials of one recording, (T, N); each begins and ends at rest at home."""
    steps = round(kind.trial_s / STEP_S)
    time_s = _times_s(steps)
    trials = [draw_trial(kind, rng, time_s) for draw_trial in _TRIALS]
    angle = kind.home_rad + np.concatenate(trials) * kind.reach_rad
    return ReferenceMotion(*_with_rates(angle, STEP_S))


def _with_rates(course: Array, step_s: float) -> tuple[Array, Array, Array]:
    """A course (T, …), its first and its second derivative."""
    rate = np.gradient(course, step_s, axis=0)
    return course, rate, np.gradient(rate, step_s, axis=0)


def _sines(kind: RobotKind, rng: np.random.Generator, time_s: Array) -> Array:
    """Four sines by joint, as identification of robots takes them."""
    count = len(kind.home_rad)
    frequency = kind.speed_hz * rng.uniform(0.15, 1.0, (4, count))
    phase = rng.uniform(0.0, 2.0 * np.pi, (4, count))
    share = rng.uniform(0.3, 1.0, (4, count))
    waves = np.sin(2.0 * np.pi * frequency * time_s[:, None, None] + phase)
    whole = (share * waves).sum(1) / share.sum(0) * 1.4
    edge = np.minimum(time_s, time_s[-1] - time_s) / (_TAPER * time_s[-1])
    return np.asarray(whole * _smooth(edge)[:, None])


def _points(kind: RobotKind, rng: np.random.Generator, time_s: Array) -> Array:
    """Motion from point to point with a rest at each, and home again."""
    count = max(2, int(time_s[-1] / (_MOVE_S + _HOLD_S)))
    slot_s = time_s[-1] / count
    goals = rng.uniform(-1.0, 1.0, (count + 1, len(kind.home_rad)))
    goals[[0, -1]] = 0.0
    slot = np.minimum((time_s / slot_s).astype(int), count - 1)
    share = _smooth((time_s - slot * slot_s) / (slot_s * _MOVE_S / (_MOVE_S + _HOLD_S)))
    return np.asarray(goals[slot] + share[:, None] * (goals[slot + 1] - goals[slot]))


def _slow(kind: RobotKind, rng: np.random.Generator, time_s: Array) -> Array:
    """Every joint to one side and the other, once or twice in the trial."""
    turns = rng.integers(1, 3, len(kind.home_rad)) * rng.choice([-1, 1], len(kind.home_rad))
    share = (time_s / time_s[-1])[:, None]
    edge = np.minimum(share, 1.0 - share) / _TAPER
    return np.asarray(0.9 * np.sin(2.0 * np.pi * turns * share) * _smooth(edge))


_TRIALS = (_sines, _points, _sines, _slow, _points, _sines)
"""The trials of a recording, in their order."""


def _smooth(share: Array) -> Array:
    """From 0 to 1 without a jump of acceleration."""
    s = np.clip(share, 0.0, 1.0)
    return np.asarray(s**3 * (10.0 - 15.0 * s + 6.0 * s**2))


def stacked_references(references: Sequence[ReferenceMotion]) -> ReferenceMotion:
    """References of several robots, (T, B, N)."""
    return ReferenceMotion(*(np.stack(parts, 1) for parts in zip(*references, strict=True)))


def prescribed_n_m(kind: RobotKind, robot: RealRobot, asked: ReferenceMotion) -> Array:
    """Torques (T', N) that sensors would read if one robot followed its reference exactly.

    Every eighth step. It serves to size hidden causes: quick, without a controller, friction
    without its past.
    """
    asked = ReferenceMotion(*(part[::_STRIDE, None, :] for part in asked))
    time_s = _times_s(len(asked.angle), _STRIDE)
    step_s = STEP_S * _STRIDE
    robots: RealRobot = stacked([robot])
    gain = 1.0 + robots.encoder_scale
    motor = [(asked.angle - robots.zero) / gain, asked.speed / gain, asked.acceleration / gain]
    joint = [part @ robot.moved.T for part in motor]
    base = np.zeros_like(time_s)[:, None, None]
    chain = robots.on_base()
    if robots.play_rad.any():
        still = [np.concatenate([base, part], -1) for part in joint]
        borne = np.sign(chain.torques_n_m(*still)[..., 1:])
        behind = gaussian_filter1d(-0.5 * robots.play_rad * borne, _PASSING_ROWS, axis=0)
        joint = [a + b for a, b in zip(joint, _with_rates(behind, step_s), strict=True)]
    moment = chain.torques_n_m(*(np.concatenate([base, part], -1) for part in joint))[..., :1]
    give = _with_rates(-moment / robot.base_stiffness, step_s)
    whole = [np.concatenate(parts, -1) for parts in zip(give, joint, strict=True)]
    at_joint = chain.torques_n_m(*whole)[..., 1:] + robots.spring_n_m(joint[0])
    drive = at_joint @ robot.moved
    drive = drive + robots.armature * motor[2] + robots.motor_n_m(motor[0], motor[1])
    drive = drive - _push(robots, time_s, kind.trial_s)
    if kind.rubbing and robots.capstan.any():
        lost_n_m = kind.rubbing(robots.capstan, joint[0][0])
        lost = np.zeros_like(drive)
        for k in range(1, len(drive)):
            lost[k] = lost_n_m(joint[0][k], drive[k] + lost[k - 1])
        drive = drive + lost
    drive = drive + np.tanh(motor[1] / 0.01) * robots.kinetic_n_m(motor[0], motor[1], drive)
    drive = drive + robots.bristles.steady_n_m(motor[1])
    return robots.read_n_m(drive / robots.passed_share(motor[0]), time_s)[:, 0]


def _push(robots: RealRobot, time_s: Array, trial_s: float) -> Array:
    """(T, B, N) torque by someone, who comes and goes."""
    since = time_s / trial_s - np.floor(time_s / trial_s)
    strength = _smooth(np.minimum(since - 0.4, 0.95 - since) / 0.1)[:, None, None]
    now = np.floor(time_s / trial_s)[:, None, None] == robots.push_trial
    return np.asarray(strength * now * robots.push)


class DrivenMotion(NamedTuple):
    """What B robots did, (T, B, N) at every step.

    Attributes:
        motor, motor_speed: angles and speeds of the motors.
        joint: angles of the joints.
        drive_n_m: torques of the motors.
        command: the controllers' requests: torques, or angles of position servos.
    """

    motor: Array
    motor_speed: Array
    joint: Array
    drive_n_m: Array
    command: Array


def simulate(kind: RobotKind, robots: RealRobot, asked: ReferenceMotion) -> DrivenMotion:
    """Robots under their controllers: midpoint steps, with exactly integrated bristles.

    The controllers know the nominal robot: its torques for the reference, and a feedback of
    position and speed scaled by its inertia. Position servos have only feedback of the
    motor's angle, and damping.
    """
    nominal = stacked([kind.nominal()[0]])
    forward = nominal.chain.torques_n_m(*asked) + nominal.armature * asked.acceleration
    forward = forward + nominal.spring_n_m(asked.angle)
    forward = forward + nominal.motor_n_m(asked.angle, asked.speed)
    stiff, damp = kind.gains()
    stiff = (1.0 + robots.servo_scale) * stiff
    back = np.asarray(np.linalg.inv(robots.moved), dtype=float)
    gain = 1.0 + robots.encoder_scale
    zero = robots.zero
    if kind.servos:  # zero and scale are the camera's
        gain = np.ones_like(gain)
        zero = np.zeros_like(zero)
    count = asked.angle.shape[1]
    home = times(robots.moved, (asked.angle[0] - zero) / gain)
    angle = np.concatenate([np.zeros((count, 1)), home], 1)
    links = angle.shape[1]
    chain = robots.on_base()
    loose = robots.play_rad > 0.0  # there the rotor is a mass of its own
    fixed = np.where(loose, 0.0, robots.armature)
    inertia = np.swapaxes(back, 1, 2) * fixed[:, None, :] @ back
    carried = chain.mass_matrix(angle)[:, 0, 0]
    base_own, base_damping = robots.base(carried)
    extra = np.zeros((count, links, links))
    extra[:, 0, 0] = base_own
    extra[:, 1:, 1:] = inertia
    push = _push(robots, _times_s(len(asked.angle)), kind.trial_s)
    lost_n_m = kind.rubbing and kind.rubbing(robots.capstan, home)
    bristle = np.zeros_like(home)
    bend = np.zeros_like(home)
    drive = forward[0].copy()
    kept = np.empty((5, *asked.angle.shape))
    steps = max(
        _STEPS_OF_PLAY if loose.any() else 1,
        _steps_of_bristles(robots, chain.mass_matrix(angle) + extra),
    )
    step_s = STEP_S / steps
    angle = np.concatenate([angle, times(back, home)], 1)
    speed = np.zeros_like(angle)

    def at_motors(whole: Array) -> Array:
        return np.where(loose, whole[:, links:], times(back, whole[:, 1:links]))

    def accelerations(angle: Array, speed: Array, held: Array) -> Array:
        """(B, 1 + 2N) of the base, the joints, and rotors with play."""
        motor = at_motors(angle)
        motor_speed = at_motors(speed)
        linked = angle[:, :links]
        rate = speed[:, :links]
        torque = held - robots.motor_n_m(motor, motor_speed)
        passed = robots.flank_n_m(motor - linked[:, 1:], motor_speed - rate[:, 1:])
        free = np.where(loose, torque - passed, 0.0) / np.where(loose, robots.armature, 1.0)
        torque = np.where(loose, passed, torque)
        base = -robots.base_stiffness[:, 0] * linked[:, 0] - base_damping * rate[:, 0]
        joint = times(np.swapaxes(back, 1, 2), torque) - robots.spring_n_m(linked[:, 1:])
        whole = np.concatenate([base[:, None], joint], 1)
        return np.concatenate([chain.accelerations(linked, rate, whole, extra), free], 1)

    for k in range(len(asked.angle)):
        motor = at_motors(angle)
        motor_speed = at_motors(speed)
        error = asked.angle[k] - gain * motor - zero
        if kind.servos:
            command = stiff * error - damp * motor_speed
        else:
            command = forward[k] + stiff * error + damp * (asked.speed[k] - gain * motor_speed)
        recorded = asked.angle[k] if kind.servos else command
        kept[:, k] = motor, motor_speed, angle[:, 1:links], drive, recorded
        drive = drive + (command - drive) * (STEP_S / _CURRENT_S)
        rate = np.abs(motor_speed) / robots.presliding_rad
        slip = -np.expm1(-rate * STEP_S)
        grown = np.where(rate > 1e-9, slip / np.maximum(rate, 1e-9), STEP_S)
        bristle = bristle * (1.0 - slip) + motor_speed * grown
        slides = robots.kinetic_n_m(motor, motor_speed, drive)
        friction = slides * bristle / robots.presliding_rad
        held = drive * robots.passed_share(motor) - friction + push[k]
        if lost_n_m:
            held = held - lost_n_m(angle[:, 1:links], drive)
        for _ in range(steps):
            bend, bent_n_m = robots.bristles.stepped(bend, at_motors(speed), step_s)
            left = held - bent_n_m
            middle = speed + 0.5 * step_s * accelerations(angle, speed, left)
            then = accelerations(angle + 0.5 * step_s * speed, middle, left)
            angle = angle + step_s * middle
            speed = speed + step_s * then
    if not np.isfinite(angle).all():
        raise PlantError(f"{kind.name}: a controlled robot flew away; draw with another seed")
    return DrivenMotion(*kept)


def _steps_of_bristles(robots: RealRobot, inertia: Array) -> int:
    """Within one step, as many as a joint takes that swings on bristles that do not slip.

    `inertia` (B, 1 + N, 1 + N) is that of the base and the joints, with rotors.
    """
    moved = np.linalg.inv(inertia)[:, 1:, 1:].diagonal(axis1=1, axis2=2)
    swing_rad_s = float(np.sqrt((robots.bristles.stiffness_n_m_rad * moved).max()))
    return max(1, int(np.ceil(STEP_S * swing_rad_s / _SWING_RAD)))


def written(
    kind: RobotKind, robots: RealRobot, motion: DrivenMotion, seeds: Sequence[int]
) -> list[pd.DataFrame]:
    """The recording of each robot."""
    time_s = _times_s(len(motion.motor))
    (_, joints, _) = kind.nominal()
    read = robots.read_n_m(motion.drive_n_m, time_s)
    seen = motion.joint if kind.servos else motion.motor
    angle = (1.0 + robots.encoder_scale) * seen + robots.zero
    rows = slice(None, None, round(1.0 / (kind.rate_hz * STEP_S)))
    tables = []
    for b, seed in enumerate(seeds):
        rng = np.random.default_rng(seed)
        jitter = 0.5 * kind.encoder_rad * rng.standard_normal(angle[:, b].shape)
        counted = np.round((angle[:, b] + jitter) / kind.encoder_rad) * kind.encoder_rad
        change = np.diff(counted, axis=0, prepend=counted[:1]) / STEP_S
        noise = _lagged(rng.standard_normal(read[:, b].shape), _FILTER_S)
        noise *= kind.noise_n_m / noise.std(0)
        step = 0.5 * kind.noise_n_m
        torque = np.round((_lagged(read[:, b], _FILTER_S) + noise) / step) * step
        command = motion.command[:, b]
        if kind.pulls_n:
            command = kind.pulls_n(motion.motor[:, b], motion.drive_n_m[:, b], command)
        trial = np.floor(time_s[rows] / kind.trial_s + 1e-9).astype(int)
        table = {"time_s": time_s[rows], "trial": trial}
        measured = {"position": counted}
        if not kind.servos:
            measured |= {"velocity": _lagged(change, _VELOCITY_S), "torque": torque}
        for what, values in measured.items():
            table |= {f"{what}.{j}": c for j, c in zip(joints, values[rows].T, strict=True)}
        if kind.drives:
            commands = zip(kind.drives, command[rows].T, strict=True)
            table |= {f"command.{drive}": column for drive, column in commands}
        tables.append(pd.DataFrame(table))
    return tables


def _lagged(signal: Array, time_s: float) -> Array:
    from scipy.signal import lfilter

    share = 1.0 - np.exp(-STEP_S / time_s)
    start = (1.0 - share) * signal[:1]
    return np.asarray(lfilter([share], [1.0, share - 1.0], signal, axis=0, zi=start)[0])


def _times_s(steps: int, stride: int = 1) -> Array:
    return np.asarray(np.arange(steps) * (STEP_S * stride), dtype=float)
