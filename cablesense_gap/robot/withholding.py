"""Recordings of robots with something hidden in them, to try the diagnosis on.

The hidden side is MuJoCo's forward dynamics under a controller that knows the nominal model, with
friction as MuJoCo's constraint has it, and encoders and torques with steps and noise: another way
than the diagnosis, which goes from motion to torques.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from cablesense_base import Array
from cablesense_base.files import written_whole
from cablesense_gap.recordings.csv_file import write_table
from cablesense_gap.recordings.recording import RecordingError
from cablesense_gap.robot.catalogue import changed, known_effects
from cablesense_gap.robot.effects.effect import WHOLE_ARM, RobotEffect, Scale
from cablesense_gap.robot.model import Change, Robot, RobotError, inverse_dynamics
from cablesense_gap.robot.protocol import RATE_HZ, standard_protocol
from cablesense_gap.robot.smoothing import derivatives
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import NONE, UNKNOWN

_STEP_S, _STEP_OF_TEETH_S = 1e-3, 5e-4
_TEETH_RAD_S = 500.0
"""At which a rotor would swing on a tooth."""
_LEAST_ROTOR = 0.04
"""Rotor inertia by the joint's inertia, if the model has almost none."""
_RAD_S_OF_CONTROL = 30.0
_ENCODER_STEP = 2.0 * np.pi / 2**16
_NOISE_SHARE = 0.01
_SIZES = (2.0, 5.0)
"""Range of hidden sizes, by the typical size."""
_COGGING_PER_RAD = 9.0
_SMOOTH_SPEED = 0.01
_ATTEMPTS = 8


@dataclass(frozen=True)
class WithheldEffects:
    """What one recording hides; `places` are joints and bodies."""

    recording: str
    effects: str
    places: str


def withhold(
    folder: Path, answers: Path, robot: Robot, count: int, seed: int, only: Sequence[str] = ()
) -> Iterator[WithheldEffects]:
    """Write `case_001.csv` and so on, and the answers at the end; gives each when it is written.

    Raises:
        RobotError: `only` names no effect.
        RecordingError: a place cannot be written to.
    """
    every = [e for e in known_effects().values() if e.withheld and not e.tolerance]
    offered = [e.name for e in every if e.places(robot)]
    for name in {part for each in only for part in each.split("+")} - {*offered, NONE, UNKNOWN}:
        raise RobotError(f"{name!r} cannot be hidden; valid: none, unknown, {', '.join(offered)}")
    motion = _ProtocolMotion(robot)
    found = []
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        asked = only[k % len(only)] if only else _drawn(rng, offered)
        hidden = _case(folder / f"case_{k + 1:03d}.csv", motion, asked, rng)
        found.append(hidden)
        yield hidden
    rows = [f"{h.recording},{h.effects},{h.places}" for h in found]
    with written_whole(answers, RecordingError) as beside:
        beside.write_text("\n".join(["recording,effects,where", *rows]) + "\n", encoding="utf-8")


def _drawn(rng: np.random.Generator, offered: Sequence[str]) -> str:
    kind = rng.random()
    if kind < 0.2:
        return NONE
    if kind < 0.4:
        return UNKNOWN
    several = 2 if kind > 0.85 else 1
    return "+".join(sorted(rng.choice(offered, several, replace=False)))


class _ProtocolMotion:
    """The protocol's motion and what the nominal robot needs for it."""

    def __init__(self, robot: Robot) -> None:
        self.robot, self.blocks = robot, standard_protocol(robot)
        self.moved = [(b.position, *derivatives(b.position, RATE_HZ)) for b in self.blocks]
        self.torque = [inverse_dynamics(robot.model, *each) for each in self.moved]
        speed, acceleration, torque = (
            np.concatenate(each)
            for each in ([m[1] for m in self.moved], [m[2] for m in self.moved], self.torque)
        )
        position = np.concatenate([m[0] for m in self.moved])
        sizes = np.sqrt((torque**2).mean(0))
        self.scale = Scale(
            torque=np.maximum(sizes, 1e-2 * sizes.max()),
            speed=np.sqrt((speed**2).mean(0)),
            acceleration=np.sqrt((acceleration**2).mean(0)),
            position=0.5 * np.ptp(position, axis=0),
        )


def _case(
    path: Path, motion: _ProtocolMotion, asked: str, rng: np.random.Generator
) -> WithheldEffects:
    robot, scale = motion.robot, motion.scale
    names = [] if asked in (NONE, UNKNOWN) else asked.split("+")
    for _ in range(_ATTEMPTS):
        values = [_sized(known_effects()[name], robot, scale, rng) for name in names]
        tolerances = {
            Term(e.name, place, p.name): float(rng.normal(0.0, p.typical))
            for e in known_effects().values()
            if e.tolerance
            for place in e.places(robot)
            for p in e.parameters(robot, scale)
        }
        cogging = np.zeros(len(robot.joints))
        if asked == UNKNOWN:
            joint = int(rng.integers(len(cogging)))
            cogging[joint] = rng.uniform(0.1, 0.3) * scale.torque[joint]
        hidden = changed(robot, [tolerances, *values])
        tables = [_trial(motion, k, hidden, cogging, rng) for k in range(len(motion.blocks))]
        if all(np.isfinite(table).all() for table in tables):
            break
    else:
        raise RobotError(f"{robot.path}: cannot be held on the protocol's motion with {asked}")
    columns = ["time_s", "trial"]
    columns += [f"{kind}.{joint}" for kind in ("position", "torque") for joint in robot.joints]
    rows = np.concatenate(tables)
    write_table(path, dict(zip(columns, rows.T, strict=True)), "%.7g")
    places = dict.fromkeys(t.place for each in values for t in each if t.place != WHOLE_ARM)
    return WithheldEffects(path.stem, asked, " ".join(places))


def _sized(
    effect: RobotEffect, robot: Robot, scale: Scale, rng: np.random.Generator
) -> dict[Term, float]:
    """One effect in one place, some typical sizes large."""
    place = str(rng.choice(effect.places(robot)))
    found = {}
    for p in effect.parameters(robot, scale):
        sign = 1.0 if p.low >= 0.0 else float(rng.choice([-1.0, 1.0]))
        size = sign * rng.uniform(*_SIZES) * p.typical
        found[Term(effect.name, place, p.name)] = float(np.clip(size, p.low, p.high))
    return found


def _trial(
    motion: _ProtocolMotion, k: int, hidden: Change, cogging: Array, rng: np.random.Generator
) -> Array:
    """Rows of one block: time, trial, positions and torques as they are read."""
    robot = motion.robot
    model = robot.varied(hidden)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    loose = hidden.play > 0.0  # there the rotor is a mass of its own
    step_s = _STEP_OF_TEETH_S if loose.any() else _STEP_S
    model.opt.timestep = step_s
    data, steps = mujoco.MjData(model), round(1.0 / RATE_HZ / step_s)
    apart = np.eye(len(robot.joints)) + hidden.coupling
    inertia = np.zeros((model.nv, model.nv))
    position, speed, _ = motion.moved[k]
    data.qpos[:], data.qvel[:] = position[0], speed[0]
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, inertia)
    stiff = inertia.diagonal() * _RAD_S_OF_CONTROL**2
    damp = 2.0 * inertia.diagonal() * _RAD_S_OF_CONTROL
    rotor = np.maximum(model.dof_armature, _LEAST_ROTOR * inertia.diagonal())
    model.dof_armature[loose] = model.dof_damping[loose] = 0.0
    drive, turning = data.qpos.copy(), data.qvel.copy()
    found_position, found_torque = np.empty_like(position), np.empty_like(position)
    asked = np.hstack([position, speed, motion.torque[k]])
    for row in range(len(position)):
        last, now = asked[max(row - 1, 0)], asked[row]
        for step in range(1, steps + 1):
            place, rate, known = np.split(last + (now - last) * step / steps, 3)
            drive = np.where(loose, drive, data.qpos)
            turning = np.where(loose, turning, data.qvel)
            torque = known + stiff * (place - drive) + damp * (rate - turning)
            friction = hidden.load_friction * np.abs(torque) * np.tanh(turning / _SMOOTH_SPEED)
            applied = torque - friction + cogging * np.sin(_COGGING_PER_RAD * drive)
            pressed = drive - data.qpos
            pressed -= np.clip(pressed, -0.5 * hidden.play, 0.5 * hidden.play)
            closing = _TEETH_RAD_S**2 * pressed + _TEETH_RAD_S * (turning - data.qvel)
            passed = rotor * np.where(pressed * closing > 0.0, closing, 0.0)
            data.qfrc_applied[:] = np.where(loose, passed, applied)
            turning += step_s / rotor * (applied - hidden.damping * turning - passed)
            drive = drive + step_s * turning
            mujoco.mj_step(model, data)
        found_position[row], found_torque[row] = np.where(loose, drive, data.qpos), torque
    encoder = np.linalg.solve(apart, found_position.T).T
    encoder = encoder * (1.0 + hidden.encoder_scale) + hidden.zero
    time_s = np.arange(len(position)) / RATE_HZ
    at_drive = found_torque @ apart
    late = [np.interp(time_s - hidden.delay_s, time_s, own) for own in at_drive.T]
    read = (1.0 + hidden.torque_scale) * np.array(late).T + hidden.torque_offset
    read += rng.normal(0.0, _NOISE_SHARE * motion.scale.torque, read.shape)
    encoder = np.round(encoder / _ENCODER_STEP) * _ENCODER_STEP
    begin_s = sum(block.duration_s + 1.0 for block in motion.blocks[:k])
    trial = np.full(len(position), k + 1)
    return np.column_stack([begin_s + time_s, trial, encoder, read])
