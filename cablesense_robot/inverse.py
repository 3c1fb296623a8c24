"""Measured motion in, torques out: what the model says the drives must have given.

Positions are smoothed with a stated bandwidth, and what is compared with them goes through the
same filter (`smoothing`). Nothing is integrated, so nothing drifts. A joint at rest tells nothing:
dry friction may hold any torque there, so its rows do not count at that joint.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cablesense_base import Array
from cablesense_gap.recordings.recording import RecordingError
from cablesense_robot import smoothing
from cablesense_robot.effects.effect import Scale
from cablesense_robot.model import Change, Robot
from cablesense_robot.recording import RobotRecording

MOST_ROWS = 5000
"""Rows that are compared; a longer recording has them farther apart."""

_ROWS_A_PERIOD = 3.0
_LEAST_FLOOR = 0.005
"""Of a joint's torque: no model of a machine is better."""
_SLOW_SHARE = 0.02
"""Of a joint's usual speed; slower is standing still, as far as friction is concerned."""
_NOISE_DEVIATIONS = 3.0
_LEAST_MOVING = 0.05
_REST_S = 0.4
_OF_BODIES = ("mass_kg", "centre_m", "inertia_kg_m2")
_OF_MOTION = ("gravity_m_s2", "zero", "encoder_scale", "coupling")
_LEAST_KG = 1e-9
_PLACES = np.array([*np.zeros((1, 3)), *np.eye(3), *-np.eye(3), *(1.0 - np.eye(3))])
"""Of point masses, m; their inertial parameters are independent."""
_CACHED = 48
_FEWEST_ROWS = 50


@dataclass(frozen=True)
class Motion:
    """A recording as it is compared: R rows about a third of the bandwidth's period apart.

    Attributes:
        position, speed, acceleration: (R, J), smoothed.
        direction: (R, J) of each joint's motion, -1 to 1, smoothed like all the rest.
        torque: (R, J) of the drives, smoothed; NaN for joints without.
        counts: (R, J) where the torque tells something.
        floor: (J,) what noise of torques and positions leaves of any model.
        scale: how large torques and motion are.
        rows_s: how far rows are apart.
    """

    time_s: Array
    trial: NDArray[np.int64]
    position: Array
    speed: Array
    acceleration: Array
    direction: Array
    torque: Array
    counts: NDArray[np.bool_]
    floor: Array
    scale: Scale
    bandwidth_hz: float
    rows_s: float

    def __len__(self) -> int:
        """How many rows."""
        return len(self.time_s)


def prepared(recording: RobotRecording, robot: Robot, bandwidth_hz: float | None = None) -> Motion:
    """The recording's motion and torques, smoothed; the widest bandwidth that noise allows.

    Raises:
        RecordingError: it has neither torques nor commands, or its trials are too short.
    """
    trials = _evenly_sampled(recording)
    rate_hz = 1.0 / trials[0].interval_s
    with_torque = np.isfinite(recording.torque).any(axis=0)
    by_command = not with_torque.any()
    if by_command and not (recording.command.size and np.isfinite(recording.command).all()):
        raise RecordingError(
            f"{recording.name}: has neither torque.<joint> nor the commands of all actuators; "
            "a comparison by inverse dynamics needs either"
        )
    noise = _noise(trials, rate_hz)
    inertia = _inertia(robot, recording.position)
    if bandwidth_hz is None:
        bandwidth_hz = _widest(noise, inertia, recording, rate_hz)
    elif not 0.1 <= bandwidth_hz <= rate_hz / 4.0:
        raise RecordingError(
            f"{recording.name}: a bandwidth of {bandwidth_hz:g} Hz must be from 0.1 to "
            f"{rate_hz / 4.0:.3g} Hz, a quarter of the recording's rate"
        )
    step = max(
        1,
        round(rate_hz / (_ROWS_A_PERIOD * bandwidth_hz)),
        -(-sum(len(t.position) for t in trials) // MOST_ROWS),
    )
    edge = round(0.5 * rate_hz / bandwidth_hz)
    speed_noise = np.sqrt(noise.position) * 2.0 * np.pi * bandwidth_hz**1.5 / np.sqrt(3.0)
    slow = _slow(trials, rate_hz, bandwidth_hz, speed_noise)
    parts = [_of_trial(t, rate_hz, bandwidth_hz, slow, robot, by_command) for t in trials]
    kept = [slice(edge, max(len(t.position) - edge, edge), step) for t in trials]
    joined = {
        f.name: np.concatenate(
            [getattr(p, f.name)[rows] for p, rows in zip(parts, kept, strict=True)]
        )
        for f in fields(_Smoothed)
    }
    moving = joined.pop("moving")
    position, torque = joined["position"], joined["torque"]
    if len(position) < _FEWEST_ROWS:
        raise RecordingError(
            f"{recording.name}: {len(position)} rows are left of it after smoothing; record "
            "trials of several seconds"
        )
    counts = (moving | (moving.mean(0) < _LEAST_MOVING)) & np.isfinite(torque)
    scale = _scale(torque, joined["speed"], joined["acceleration"], position, moving)
    floor = np.hypot(
        smoothing.noise_of_smoothed(noise.torque, bandwidth_hz),
        inertia * smoothing.noise_of_acceleration(noise.position, bandwidth_hz),
    )
    floor = np.maximum(floor, _at_rest(parts, rate_hz))
    joined["trial"] = np.unique(joined["trial"], return_inverse=True)[1]
    return Motion(
        **joined,
        counts=counts,
        floor=np.maximum(floor, _LEAST_FLOOR * scale.torque),
        scale=scale,
        bandwidth_hz=float(bandwidth_hz),
        rows_s=step / rate_hz,
    )


class InverseDynamics:
    """Torques that variants of a robot need for one motion."""

    def __init__(self, robot: Robot, motion: Motion) -> None:
        """`motion` is what was measured."""
        self._robot, self._motion = robot, motion
        self._nominal = robot.nominal()
        self._cached: dict[tuple[bytes, ...], Array] = {}
        self._own: Array | None = None
        self._columns: dict[int, Array] = {}

    def torques(self, change: Change) -> Array:
        """(R, J) as the drives' torques would be read."""
        motion, nominal = self._motion, self._nominal
        moved = self._moved(change)
        position, speed, acceleration = moved
        transmitted = (
            self._rigid(change, moved)
            + (change.armature - nominal.armature) * acceleration
            + (change.damping - nominal.damping) * speed
            + (change.stiffness - nominal.stiffness) * (position - self._robot.model.qpos_spring)
        )
        rubbing = change.friction + change.load_friction * np.abs(transmitted)
        at_drive = transmitted + rubbing * motion.direction
        if change.coupling.any():
            at_drive = at_drive + at_drive @ change.coupling
        if change.delay_s:
            at_drive = self._later(at_drive, change.delay_s)
        return np.asarray((1.0 + change.torque_scale) * at_drive + change.torque_offset)

    def _moved(self, change: Change) -> tuple[Array, Array, Array]:
        """Position, speed and acceleration of the joints, of what encoders read."""
        motion = self._motion
        true = 1.0 + change.encoder_scale
        found = (
            (motion.position - change.zero) / true, motion.speed / true, motion.acceleration / true
        )  # fmt: skip
        if change.coupling.any():
            position, speed, acceleration = (each + each @ change.coupling.T for each in found)
            return position, speed, acceleration
        return found

    def _rigid(self, change: Change, moved: tuple[Array, Array, Array]) -> Array:
        """Torques of the bodies, with the nominal model's springs, dampers and rotors."""
        elsewhere = change.key(*_OF_MOTION)
        if elsewhere == self._nominal.key(*_OF_MOTION):
            return self._by_inertia(change)
        key = (*elsewhere, *change.key(*_OF_BODIES))
        if key not in self._cached:
            if len(self._cached) >= _CACHED:
                self._cached.pop(next(iter(self._cached)))
            self._cached[key] = self._whole(change, moved)
        return self._cached[key]

    def _whole(self, change: Change, moved: tuple[Array, Array, Array]) -> Array:
        nominal = self._nominal
        held = replace(
            change,
            armature=nominal.armature,
            damping=nominal.damping,
            stiffness=nominal.stiffness,
        )
        return inverse_dynamics(self._robot.varied(held), *moved)

    def _by_inertia(self, change: Change) -> Array:
        """Linear in masses, first moments and inertias: exact, and quick."""
        if self._own is None:
            motion = self._motion
            moved = motion.position, motion.speed, motion.acceleration
            self._own = self._whole(self._nominal, moved)
        torque, nominal = self._own, self._nominal
        more = change.inertial_parameters() - nominal.inertial_parameters()
        for b in np.flatnonzero(more.any(axis=1)).tolist():
            if b not in self._columns:
                self._columns[b] = self._regressor(b)
            torque = torque + self._columns[b] @ more[b]
        return torque

    def _regressor(self, b: int) -> Array:
        """(R, J, 10) torques by a body's inertial parameters, from ten point masses on it."""
        robot, motion = self._robot, self._motion
        light = copy.copy(robot.model)
        light.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SPRING
        light.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_DAMPER
        light.dof_armature[:] = 0.0
        bare = replace(robot, model=light).nominal()
        bare.mass_kg[:], bare.inertia_kg_m2[:] = _LEAST_KG, _LEAST_KG * np.eye(3)
        own = replace(robot, model=light)
        moved = motion.position, motion.speed, motion.acceleration
        torques, parameters = [], []
        for place in _PLACES:
            with_mass = bare.copied()
            with_mass.centre_m[b] = place
            with_mass.mass_kg[b] = 1.0
            torques.append(inverse_dynamics(own.varied(with_mass), *moved))
            parameters.append(with_mass.inertial_parameters()[b])
        return np.einsum("kri,pk->rip", torques, np.linalg.inv(np.array(parameters)))

    def _later(self, torque: Array, delay_s: float) -> Array:
        motion, found = self._motion, np.empty_like(torque)
        for t in np.unique(motion.trial):
            rows = motion.trial == t
            time_s = motion.time_s[rows]
            if len(time_s) < 4:
                found[rows] = torque[rows]
                continue
            at = np.clip(time_s - delay_s, time_s[0], time_s[-1])
            found[rows] = CubicSpline(time_s, torque[rows])(at)
        return found

    def __getstate__(self) -> dict[str, object]:
        """Without what is worked out again."""
        return {**self.__dict__, "_cached": {}}


def inverse_dynamics(
    model: mujoco.MjModel, position: Array, speed: Array, acceleration: Array
) -> Array:
    """(R, J) generalised forces that a motion needs, without friction, contacts and limits."""
    free = copy.copy(model)
    free.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    free.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR
    data = mujoco.MjData(free)
    found = np.empty_like(position)
    qpos, qvel, qacc, forces = data.qpos, data.qvel, data.qacc, data.qfrc_inverse
    inverse = mujoco.mj_inverse
    for row in range(len(position)):
        qpos[:], qvel[:], qacc[:] = position[row], speed[row], acceleration[row]
        inverse(free, data)
        found[row] = forces
    return found


@dataclass(frozen=True)
class _Smoothed:
    """One trial, as `Motion`, at the recording's rate; and which joints move."""

    trial: NDArray[np.int64]
    time_s: Array
    position: Array
    speed: Array
    acceleration: Array
    direction: Array
    torque: Array
    moving: NDArray[np.bool_]


@dataclass(frozen=True)
class _Trial:
    number: int
    time_s: Array
    position: Array
    torque: Array
    command: Array
    interval_s: float


@dataclass(frozen=True)
class _Noise:
    """Densities (J,), by hertz."""

    position: Array
    torque: Array


def _evenly_sampled(recording: RobotRecording) -> list[_Trial]:
    """Every trial at one rate, that of most rows."""
    same = np.diff(recording.trial) == 0
    interval_s = float(np.median(np.diff(recording.time_s)[same]))
    found = []
    for t in np.unique(recording.trial):
        rows = np.flatnonzero(recording.trial == t)
        own = recording.time_s[rows]
        count = int((own[-1] - own[0]) / interval_s + 0.5) + 1
        if count < 16:
            continue
        time_s = own[0] + interval_s * np.arange(count)

        def at(
            values: Array,
            rows: NDArray[np.int64] = rows,
            own: Array = own,
            time_s: Array = time_s,
        ) -> Array:
            columns = [np.interp(time_s, own, column) for column in values[rows].T]
            return np.array(columns).reshape(len(columns), len(time_s)).T

        found.append(
            _Trial(
                int(t), time_s, at(recording.position), at(recording.torque),
                at(recording.command), interval_s,
            )
        )  # fmt: skip
    if not found:
        raise RecordingError(f"{recording.name}: no trial has 16 rows; record longer ones")
    return found


def _noise(trials: Sequence[_Trial], rate_hz: float) -> _Noise:
    """Median over the longer trials of what positions and torques have in the upper half."""
    longest = max(len(t.position) for t in trials)
    long = [t for t in trials if len(t.position) >= 0.5 * longest]
    densities = []
    for signals in ([t.position for t in long], [t.torque for t in long]):
        each = [smoothing.noise_density(np.nan_to_num(s), rate_hz, rate_hz / 4.0) for s in signals]
        densities.append(np.median(each, axis=0))
    return _Noise(*densities)


def _inertia(robot: Robot, position: Array) -> Array:
    """(J,) that each joint feels alone, at some of the poses."""
    model, data = robot.model, mujoco.MjData(robot.model)
    whole = np.zeros((model.nv, model.nv))
    found = []
    for row in np.linspace(0, len(position) - 1, 20).astype(int):
        data.qpos[:] = position[row]
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, whole)
        found.append(whole.diagonal().copy())
    return np.asarray(np.mean(found, axis=0))


def _widest(noise: _Noise, inertia: Array, recording: RobotRecording, rate_hz: float) -> float:
    """As wide as accelerations stay below the torques' own noise, or 1 % of the torques."""
    torque = recording.torque[:, np.isfinite(recording.torque).any(axis=0)]
    largest = np.nanmax(np.nanstd(torque, axis=0), initial=0.0) if torque.size else 0.0
    most_hz = min(smoothing.MOST_HZ, rate_hz / smoothing.SAMPLES)
    tried = np.geomspace(min(smoothing.LEAST_HZ, most_hz), most_hz, 30)
    good = tried[0]
    for bandwidth_hz in tried:
        left = inertia * smoothing.noise_of_acceleration(noise.position, bandwidth_hz)
        own = smoothing.noise_of_smoothed(noise.torque, bandwidth_hz)
        if (left <= np.maximum(own, 0.01 * largest)).all():
            good = bandwidth_hz
    return float(good)


def _slow(trials: Sequence[_Trial], rate_hz: float, bandwidth_hz: float, noise: Array) -> Array:
    """(J,) speeds below which the direction of motion is not known."""
    speeds = np.concatenate(
        [
            smoothing.derivatives(smoothing.smoothed(t.position, rate_hz, bandwidth_hz), rate_hz)[
                0
            ]
            for t in trials
        ]
    )
    usual = np.sqrt((speeds**2).mean(0))
    return np.maximum(np.maximum(_NOISE_DEVIATIONS * noise, _SLOW_SHARE * usual), 1e-9)


def _of_trial(
    trial: _Trial,
    rate_hz: float,
    bandwidth_hz: float,
    slow: Array,
    robot: Robot,
    by_command: bool,
) -> _Smoothed:

    def filtered(signal: Array) -> Array:
        return smoothing.smoothed(signal, rate_hz, bandwidth_hz)

    position = filtered(trial.position)
    speed, acceleration = smoothing.derivatives(position, rate_hz)
    direction = filtered(np.clip(speed / slow, -1.0, 1.0))
    torque = (
        _actuated(robot, position, speed, filtered(trial.command))
        if by_command
        else filtered(trial.torque)
    )
    return _Smoothed(
        np.full(len(position), trial.number), trial.time_s, position, speed, acceleration,
        direction, torque, np.abs(speed) >= slow,
    )  # fmt: skip


def _actuated(robot: Robot, position: Array, speed: Array, command: Array) -> Array:
    """(T, J) what the model's actuators make of commands."""
    model, data = robot.model, mujoco.MjData(robot.model)
    found = np.empty_like(position)
    for row in range(len(position)):
        data.qpos[:], data.qvel[:], data.ctrl[:] = position[row], speed[row], command[row]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        found[row] = data.qfrc_actuator
    return found


def _scale(
    torque: Array, speed: Array, acceleration: Array, position: Array,
    moving: NDArray[np.bool_],
) -> Scale:  # fmt: skip
    """Joints without a torque count as those with the largest."""
    sizes = np.sqrt((torque**2).mean(0))
    largest = np.nanmax(sizes)
    if not np.isfinite(largest) or largest <= 0.0:
        raise RecordingError("all torques are zero; record those of the drives")
    sizes = np.where(np.isfinite(sizes), np.maximum(sizes, 1e-3 * largest), largest)
    moved = np.maximum(moving.mean(0), 1e-6)
    return Scale(
        torque=sizes,
        speed=np.sqrt((speed**2 * moving).mean(0) / moved),
        acceleration=np.sqrt((acceleration**2 * moving).mean(0) / moved),
        position=0.5 * np.ptp(position, axis=0),
    )


def _at_rest(parts: Sequence[_Smoothed], rate_hz: float) -> Array:
    """(J,) how much smoothed torques wander while all joints stand still; zero without a rest."""
    squares, count = 0.0, 0
    least = int(_REST_S * rate_hz)
    for part in parts:
        still = ~part.moving.any(1)
        edges = np.flatnonzero(np.diff(still.astype(int), prepend=0, append=0))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            if end - begin >= least:
                rest = part.torque[begin:end]
                squares = squares + ((rest - rest.mean(0)) ** 2).sum(0)
                count += end - begin
    if not count:
        return np.zeros(parts[0].position.shape[1])
    return np.nan_to_num(np.sqrt(squares / count))
