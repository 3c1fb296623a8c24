"""Motion predicted forward in time from measured states, over short windows.

MuJoCo steps from a smoothed state, with the recorded commands or torques, and with friction,
limits, contacts and equalities of the model. It compares the changes of position and speed
in a window, minus those of motion at constant speed.
"""

from __future__ import annotations

import copy
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco.rollout import rollout
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.diagnosis.discrepancy import Conditions
from cablesense_gap.robot.model import OF_POSITION, Change, Robot, actuated, inverse_dynamics
from cablesense_gap.robot.motion import (
    LEAST_FLOOR,
    Motion,
    MotionComparison,
    derivatives,
    inner_rows,
    smoothed,
    through,
)
from cablesense_gap.robot.transmission import GuidedTendons, PlayMotion
from cablesense_recording.recording import RecordingError

_OF_MOTION = 1.0
"""Periods of the bandwidth of the motion that a window takes at least: shorter ones show what
smoothing took of the motion."""
_OF_COMPARISON = 0.5
"""Periods of the bandwidth of the comparison that a window takes at most: in longer ones what
comes and goes averages out."""
_MOST_STEPS = 8_000
"""In all windows together; a longer recording has gaps between its windows."""
_FEWEST_WINDOWS = 15
"""Windows that a recording has at least."""
_KEPT_WINDOWS = 30
"""Windows that remain of many, however many steps they take."""
_OF_READING = tuple(name for name in OF_POSITION if name != "play")
"""Arrays of a change with which actuators act elsewhere than encoders read; play is apart, in
`Rollouts._of_play`."""
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_CONTROL = mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED


class ForwardComparison(MotionComparison):
    """Positions, then speeds, of all joints at the ends of Q windows: torques in, motion out.

    Both are beyond those of coasting on from where a window begins.
    """

    def __init__(self, robot: Robot, motion: Motion) -> None:
        """Take a robot and its motion as it was measured."""
        self._robot = robot
        span = _span(motion)
        windows = _windows(motion, span, _substeps(robot, motion))
        begins = windows.begins
        compared_trials = np.unique(windows.trials)
        self.trial = np.searchsorted(compared_trials, windows.trials)
        self.trial_labels = tuple(motion.trials[number].label for number in compared_trials)
        self._rollouts = Rollouts(robot, motion, begins, span)
        self.span_s = span / motion.rate_hz
        self.time_s = np.concatenate([each.time_s for each in motion.trials])[begins + span]
        kinds = ("position", "velocity")
        self.names = tuple(f"{k}.{j}" for k in kinds for j in robot.joints)
        self.columns = self.names
        self.units = (*robot.position_units, *(f"{unit}/s" for unit in robot.position_units))
        self.readings = self._beyond_coasting(*self._rollouts.measured(begins + span))
        noise, least = _noise_and_least(motion, self.span_s)
        self.floor = np.maximum(noise, np.fmin(least, self._by_torque(motion)))
        self.noise = self.floor
        driven = "recorded commands" if motion.by_command else "measured torques"
        self.description = (
            f"Compared forward in time: from measured states, smoothed to "
            f"{motion.smoothed_hz:.3g} Hz, with {driven} over {len(begins):,} windows of "
            f"{1e3 * self.span_s:.3g} ms, positions and speeds out."
        )

    def predicted(self, change: Change) -> Array:
        """Positions and speeds (Q, C) at the ends of the windows, by a variant of the robot."""
        position, speed = self._rollouts.predicted(change)
        return self._beyond_coasting(position[:, -1], speed[:, -1])

    def conditions(self, change: Change) -> Conditions:
        """Position, speed and load (Q, C) of each channel in the middle of each window."""
        path = self._rollouts.path
        middle = path[0].shape[1] // 2
        position, speed, acceleration = (np.tile(each[:, middle], 2) for each in path)
        return Conditions(position, speed, self.predicted(change), acceleration)

    def _by_torque(self, motion: Motion) -> Array:
        """(C,) what the least error of torques makes, where servos or springs hold against it."""
        robot = self._robot
        nominal = self.predicted(robot.nominal())
        square = np.zeros(len(self.names))
        for joint, torque in enumerate(LEAST_FLOOR * motion.scale.torque):
            change = robot.nominal()
            change.torque_offset[joint] = torque
            square += ((self.predicted(change) - nominal) ** 2).mean(0)
        return np.asarray(np.sqrt(square))

    def _beyond_coasting(self, position: Array, speed: Array) -> Array:
        """(Q, C) changes in a window, minus those at the constant speed of its beginning."""
        start, at_speed = self._rollouts.state
        return np.hstack([position - start - self.span_s * at_speed, speed - at_speed])


class Rollouts:
    """Motion of variants of a robot, from measured states on, over windows of equal length.

    Attributes:
        state: measured positions and speeds (Q, J) where the windows begin.
        path: measured positions, speeds and accelerations (Q, S, J) inside each of their S steps.
    """

    def __init__(self, robot: Robot, motion: Motion, begins: NDArray[np.int64], span: int) -> None:
        """Windows of `span` samples begin at rows (Q,) among those of all trials of a motion."""
        self._robot = robot
        self._smoothed_hz = motion.smoothed_hz
        rate_hz = motion.rate_hz
        self._substeps = _substeps(robot, motion)
        self._step_s = 1.0 / (rate_hz * self._substeps)
        self._rate_hz = rate_hz
        self._ends = _ends_of_trials(motion, begins)
        moved = [derivatives(path, rate_hz) for path in motion.paths]
        speed, acceleration = (np.concatenate(each) for each in zip(*moved, strict=True))
        position = np.concatenate(motion.paths)
        self._measured = position, speed
        self.state = self.measured(begins)
        inside = (np.arange(span * self._substeps) + 0.5) / self._substeps
        self._at = begins[:, None] + inside
        self.path = tuple(_at(each, self._at) for each in (position, speed, acceleration))
        self._play_motion = PlayMotion(robot, motion)
        self._tendons = GuidedTendons(robot, motion)
        self._motion = motion
        torques = [self._smoothed(np.nan_to_num(each.torque)) for each in motion.trials]
        self._torque = np.concatenate(torques)
        self._command = None
        if motion.by_command:
            commands = [self._smoothed(each.command) for each in motion.trials]
            self._command = np.concatenate(commands)

    def measured(self, rows: NDArray[np.int64]) -> tuple[Array, Array]:
        """Smoothed positions and speeds (…, J) at rows (…) among those of all trials."""
        position, speed = self._measured
        return position[rows], speed[rows]

    def _smoothed(self, drive: Array) -> Array:
        """What drives make (T, …), smoothed as the motion is: no state shows the rest."""
        return smoothed(drive, self._rate_hz, self._smoothed_hz)

    def predicted(self, change: Change) -> tuple[Array, Array]:
        """Positions and speeds (Q, S, J) of a variant after each step, as encoders read them."""
        robot = self._robot
        moved = np.eye(len(robot.joints)) + change.coupling
        back = np.linalg.inv(moved)
        true = 1.0 + change.encoder_scale

        def joints(position: Array, speed: Array) -> tuple[Array, Array]:
            return (position - change.zero) / true @ moved.T, speed / true @ moved.T

        sample_rows = self._at + change.delay_s * self._rate_hz
        sample_rows = np.clip(sample_rows, self._ends[:, :1], self._ends[:, 1:])
        torque = _at(self._torque, sample_rows)
        command = None
        applied = (torque - change.torque_offset) / (1.0 + change.torque_scale) @ back
        load = np.abs(applied).mean(1)
        if change.play.any():
            applied = applied - self._of_play(change)
        if change.capstan_friction.any():
            applied = applied - self._lost(change)
        if change.coupling.any():  # rotors and dampers are the drives'
            _, speed, acceleration = self.path
            at_drive = change.armature * acceleration + change.damping * speed
            speed = speed @ moved.T
            acceleration = acceleration @ moved.T
            at_joint = change.armature * acceleration + change.damping * speed
            applied = applied + at_joint - at_drive @ back
        if self._command is not None:  # the model's actuators act as well
            command = _at(self._command, sample_rows)
            by_model = torque
            if change.key(*_OF_READING) != robot.nominal().key(*_OF_READING):
                by_model = self._actuated(joints(*self.path[:2]), command)
            applied = applied - by_model
        model = robot.varied(change)
        at_joints = self._stepped(model, joints(*self.state), command, applied, change, load)
        position, speed = (each @ back.T for each in at_joints)
        return position * true + change.zero, speed * true

    def _of_play(self, change: Change) -> Array:
        """(Q, S, J) torques that links need in addition, because play changes their motion."""
        behind = [_at(each, self._at) for each in self._play_motion.moved(change.play)]
        model = self._robot.varied(change)
        model.dof_armature[:] = 0.0
        model.dof_damping[:] = 0.0
        needed = [
            inverse_dynamics(model, *(each.reshape(-1, model.nv) for each in moved))
            for moved in (
                self.path,
                [each + within for each, within in zip(self.path, behind, strict=True)],
            )
        ]
        return np.asarray((needed[1] - needed[0]).reshape(self.path[0].shape))

    def _lost(self, change: Change) -> Array:
        """(Q, S, J) what guides take of the tendons' torques, along the measured motion."""
        lost = self._tendons.lost(change, np.nan_to_num(self._motion.torque), at_drive=True)
        rows = self._motion.rows
        return np.stack([np.interp(self._at, rows, joint_lost) for joint_lost in lost.T], axis=-1)

    def _actuated(self, moved: tuple[Array, Array], command: Array) -> Array:
        """(Q, S, J) what actuators give at other positions than those that were read."""
        flat = (each.reshape(-1, each.shape[-1]) for each in (*moved, command))
        return actuated(self._robot, *flat).reshape(moved[0].shape)

    def _stepped(
        self,
        model: mujoco.MjModel,
        begin: tuple[Array, Array],
        command: Array | None,
        applied: Array,
        change: Change,
        load: Array,
    ) -> tuple[Array, Array]:
        """Positions and speeds (Q, S, J) of the joints after each step."""
        model.opt.timestep = self._step_s
        if command is None:
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
            command = np.zeros((*applied.shape[:2], model.nu))
        data = mujoco.MjData(model)
        state = np.empty(mujoco.mj_stateSize(model, _STATE))
        mujoco.mj_getState(model, data, state, _STATE)
        states = np.tile(state, (len(load), 1))
        joints = len(self._robot.joints)
        states[:, 1 : 1 + 2 * joints] = np.concatenate(begin, 1)
        models = model
        if change.load_friction.any():
            models = [copy.copy(model) for _ in load]
            for window_model, torque in zip(
                models, np.sinh(change.load_friction) * load, strict=True
            ):
                window_model.dof_frictionloss[:] += torque
        control = np.concatenate([command, applied], 2)
        rolled_out, _ = rollout(models, data, states, control, control_spec=_CONTROL)
        position = rolled_out[..., 1 : 1 + joints]
        speed = rolled_out[..., 1 + joints : 1 + 2 * joints]
        if model.opt.integrator != mujoco.mjtIntegrator.mjINT_RK4:
            # a step goes on with its last speed, which over a window is half a step too far
            position = position - 0.5 * self._step_s * (speed - begin[1][:, None])
        return position, speed


def _substeps(robot: Robot, motion: Motion) -> int:
    """Steps of the model, at its own step or somewhat less, from one sample to the next."""
    return int(np.ceil(1.0 / (motion.rate_hz * robot.model.opt.timestep) - 1e-6))


class _Windows(NamedTuple):
    """Q windows: their first rows (Q,) among those of all trials, and their trials (Q,)."""

    begins: NDArray[np.int64]
    trials: NDArray[np.int64]


def _windows(motion: Motion, span: int, substeps: int) -> _Windows:
    """The windows of a motion, each of `span` rows.

    Raises:
        RecordingError: there are too few.
    """
    begins = []
    numbers = []
    first = 0
    for number, path in enumerate(motion.paths):
        inner = inner_rows(len(path), motion.rate_hz, motion.smoothed_hz)
        trial_begins = first + np.arange(inner.start, inner.stop - span, span)
        begins.append(trial_begins)
        numbers.append(np.full(len(trial_begins), number))
        first += len(path)
    count = sum(len(rows) for rows in begins)
    stride = min(-(-count * span * substeps // _MOST_STEPS), count // _KEPT_WINDOWS)
    begin = np.concatenate(begins)[:: max(stride, 1)]
    trial = np.concatenate(numbers)[:: max(stride, 1)]
    if len(begin) < _FEWEST_WINDOWS:
        raise RecordingError(
            f"{len(begin)} windows of {span / motion.rate_hz:.2g} s are in the recording; record "
            f"trials of several seconds, for {_FEWEST_WINDOWS} at least"
        )
    return _Windows(begin, trial)


def _ends_of_trials(motion: Motion, begins: NDArray[np.int64]) -> NDArray[np.int64]:
    """First and last rows (Q, 2) of the trials of windows, among those of all trials."""
    edges = np.cumsum([0, *map(len, motion.paths)])
    trial = np.searchsorted(edges, begins, side="right") - 1
    return np.column_stack([edges[trial], edges[trial + 1] - 1])


def _span(motion: Motion) -> int:
    """Samples of a window: as few as noise allows, it grows less than what torques make."""
    least = _OF_MOTION * motion.rate_hz / motion.smoothed_hz
    most = max(_OF_COMPARISON * motion.rate_hz / motion.compared_hz, least)
    spans = np.unique(np.geomspace(least, most, 12).round().astype(int))
    for span in spans[spans >= 2]:
        noise, allowed = _noise_and_least(motion, span / motion.rate_hz)
        if (noise <= allowed).all():
            break
    return int(span)


def _noise_and_least(motion: Motion, span_s: float) -> tuple[Array, Array]:
    """(C,) noise of the channels by positions and by measured torques; the least floor."""
    drift = _noise_of_drift(motion.noise.position, span_s, motion.smoothed_hz)
    noise = [*drift]
    if not motion.by_command:
        by_torque = np.sqrt(0.5 * motion.noise.torque * span_s) / motion.inertia
        through = by_torque * span_s / np.sqrt(3.0), by_torque
        noise = [np.hypot(*each) for each in zip(drift, through, strict=True)]
    least = LEAST_FLOOR * motion.scale.torque / motion.inertia * span_s
    return np.concatenate(noise), np.concatenate([0.5 * span_s * least, least])


def _noise_of_drift(density: Array, over_s: float, bandwidth_hz: float) -> tuple[Array, Array]:
    """The error that white noise of positions causes in free motion from a smoothed state.

    Free motion starts at the first state and is compared with the last one. The result has the
    standard deviations of position and speed.
    """
    frequency, passed = through(bandwidth_hz)
    w = 2.0 * np.pi * frequency
    later = np.exp(1j * w * over_s) - 1.0
    gains = np.abs(later - 1j * w * over_s) ** 2, w**2 * np.abs(later) ** 2
    of_position, of_speed = ((passed * gain).sum() * frequency[1] for gain in gains)
    return np.sqrt(density * of_position), np.sqrt(density * of_speed)


def _at(values: Array, at: Array) -> Array:
    """(…, K) of rows (T, K) at numbers of rows (…), straight on between them."""
    low = np.minimum(at.astype(np.int64), len(values) - 2)
    share = (at - low)[..., None]
    return np.asarray((1.0 - share) * values[low] + share * values[low + 1])
