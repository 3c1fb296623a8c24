"""Positions measured outside the drives of position servos: commands in, positions out.

A servo holds its own encoder at the command, except that it yields to the torque it bears. The
zeros, scales, couplings and play between that encoder and the joint then show in a camera's
positions, and in no torque.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np

from cablesense_base import Array, some_of
from cablesense_gap.diagnosis.discrepancy import Conditions
from cablesense_gap.recordings.recording import RecordingError
from cablesense_gap.robot import smoothing
from cablesense_gap.robot.inverse import BacklashMotion, InverseDynamics
from cablesense_gap.robot.model import Change, Robot, inverse_dynamics
from cablesense_gap.robot.motion import Motion, MotionComparison

_LEAST_FLOOR = 0.002
"""Share of half the joint's range: some milliradians, the error of a calibrated camera."""


class Servos(NamedTuple):
    """The model's position servos, by joint (J,).

    Attributes:
        actuator: its number.
        per_command: position by unit of the command; `offset` is that of a command of zero.
        stiffness, damping: of the position, in torque.
    """

    actuator: Array
    per_command: Array
    offset: Array
    stiffness: Array
    damping: Array

    @staticmethod
    def of(robot: Robot) -> Servos:
        """Those of a robot.

        Raises:
            RecordingError: a joint has no position servo.
        """
        model, servo = robot.model, np.full(len(robot.joints), -1)
        for a in range(model.nu):
            at_joint = model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT
            if at_joint and model.actuator_biasprm[a, 1] < 0.0:
                servo[model.actuator_trnid[a, 0]] = a
        if (servo < 0).any():
            lacking = [robot.joints[j] for j in np.flatnonzero(servo < 0)]
            raise RecordingError(
                f"{robot.path.name}: {some_of(lacking)} without a position servo; positions "
                "measured outside are compared with the commands of an actuator `position` at "
                "every joint"
            )
        gear, bias = model.actuator_gear[servo, 0], model.actuator_biasprm[servo]
        by_position = -bias[:, 1] * gear
        return Servos(
            actuator=servo,
            per_command=model.actuator_gainprm[servo, 0] / by_position,
            offset=bias[:, 0] / by_position,
            stiffness=by_position * gear,
            damping=-bias[:, 2] * gear**2,
        )


class ServoComparison(MotionComparison):
    """Positions less those that were commanded, see `MotionComparison`."""

    def __init__(self, robot: Robot, motion: Motion) -> None:
        """The positions of `motion` are the joints'.

        Raises:
            RecordingError: a joint has no position servo.
        """
        self._motion, self._servos = motion, Servos.of(robot)
        self._dynamics = InverseDynamics(robot, motion)
        own = motion.command[:, self._servos.actuator]
        self._target = own * self._servos.per_command + self._servos.offset
        self._gaps = BacklashMotion(robot, self._of_drives(robot))
        self.names = self.columns = tuple(f"position.{joint}" for joint in robot.joints)
        self.units = robot.position_units
        noise = smoothing.noise_of_smoothed(motion.noise.position, motion.compared_hz)
        self.floor = self.noise = np.hypot(noise, _LEAST_FLOOR * motion.scale.position)
        self.readings = motion.passed(motion.position - self._target)
        self.trial, self.time_s = motion.compared_trial, motion.compared_time_s
        self.description = (
            "Positions measured outside the drives are compared with those that the servos' "
            "commands and the torques they bear make, with a bandwidth of "
            f"{motion.compared_hz:.3g} Hz at {len(self.trial):,} rows."
        )

    def predicted(self, change: Change) -> Array:
        """(Q, C) by a variant of the robot."""
        motion, servos = self._motion, self._servos
        target = self._target
        if change.delay_s:
            trials = [motion.trial == t for t in np.unique(motion.trial)]
            late = [self._at(rows, motion.time_s[rows] + change.delay_s) for rows in trials]
            target = np.concatenate(late)
        yields = self._torque(change) + servos.damping * motion.speed
        drive = target - yields / servos.stiffness
        joint = drive + drive @ change.coupling.T
        if change.play.any():
            joint = joint + self._gaps.moved(change.play, rows_alone=True)[0]
        read = change.zero + (1.0 + change.encoder_scale) * joint
        return motion.passed(read - self._target)

    def conditions(self, change: Change) -> Conditions:
        """As compared."""
        motion = self._motion
        parts = motion.position, motion.speed, self._torque(change)
        return Conditions(*map(motion.passed, parts))

    def _of_drives(self, robot: Robot) -> Motion:
        """The motion of the drives: the measured one has crossed the gaps already."""
        motion, servos, trials = self._motion, self._servos, []
        for trial in motion.trials:
            command = smoothing.smoothed(trial.command, motion.rate_hz, motion.smoothed_hz)
            target = command[:, servos.actuator] * servos.per_command + servos.offset
            speed, acceleration = smoothing.derivatives(trial.position, motion.rate_hz)
            torque = inverse_dynamics(robot.model, trial.position, speed, acceleration)
            yields = (torque + servos.damping * speed) / servos.stiffness
            trials.append(replace(trial, position=target - yields))
        return replace(motion, trials=tuple(trials))

    def _torque(self, change: Change) -> Array:
        """(R, J) of the drives, with the joints where they were measured."""
        none, still = np.zeros_like(change.zero), np.zeros_like(change.coupling)
        at_joint = replace(
            change, coupling=still, play=none, torque_scale=none, torque_offset=none, delay_s=0.0
        )
        torque = self._dynamics.torques(at_joint)
        return torque + torque @ change.coupling

    def _at(self, rows: Array, time_s: Array) -> Array:
        """Targets of a trial's rows at other times."""
        own = self._motion.time_s[rows]
        return np.stack([np.interp(time_s, own, each) for each in self._target[rows].T], axis=1)
