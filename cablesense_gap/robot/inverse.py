"""Measured motion in, torques out: what the model says the drives must have given.

Nothing is integrated, so nothing drifts. The positions of servos follow from these torques, too.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import NamedTuple

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from cablesense_base import Array, some_of
from cablesense_gap.diagnosis.discrepancy import Conditions
from cablesense_gap.robot.model import OF_POSITION, Change, Robot, inverse_dynamics
from cablesense_gap.robot.motion import (
    Motion,
    MotionComparison,
    Recent,
    Stribeck,
    Trajectory,
    derivatives,
    noise_of_smoothed,
    smoothed,
)
from cablesense_gap.robot.transmission import GuidedTendons, PlayMotion
from cablesense_recording.recording import RecordingError

_OF_BODIES = ("mass_kg", "centre_m", "inertia_kg_m2")
_OF_MOTION = ("gravity_m_s2", *OF_POSITION)
"""Arrays of a change with which the bodies' torques are computed anew."""
_LEAST_KG = 1e-9
"""Mass, and inertia in kg·m², of a body as good as none: the torques of point masses are added."""
_PLACES = np.array([*np.zeros((1, 3)), *np.eye(3), *-np.eye(3), *(1.0 - np.eye(3))])
"""Of point masses, m; their inertial parameters are independent."""
_LEAST_OF_RANGE = 0.002
"""Share of half a joint's range: some milliradians, the error of a calibrated camera."""


class InverseDynamics:
    """Torques that variants of a robot need for one motion."""

    def __init__(self, robot: Robot, motion: Trajectory) -> None:
        """Take a robot and its motion, measured or planned."""
        self._robot = robot
        self._motion = motion
        self._nominal = robot.nominal()
        self._play_motion = PlayMotion(robot, motion) if isinstance(motion, Motion) else None
        self._tendons = GuidedTendons(robot, motion)
        self._cached = Recent()
        self._slides = Recent()
        self._columns = Recent()

    def moved(self, change: Change) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        """Position, speed and acceleration (R, J) of the drives, and those of the joints."""
        motion = self._motion
        true = 1.0 + change.encoder_scale
        drive = (
            (motion.position - change.zero) / true,
            motion.speed / true,
            motion.acceleration / true,
        )
        behind: Array | Sequence[float] = (0.0, 0.0, 0.0)
        if self._play_motion is not None and change.play.any():
            behind = self._play_motion.moved(change.play)[:, self._play_motion.rows]
        return drive, tuple(
            drive_motion + drive_motion @ change.coupling.T + within_play
            for drive_motion, within_play in zip(drive, behind, strict=True)
        )

    def torques(self, change: Change) -> Array:
        """(R, J) as the drives' torques would be read."""
        motion = self._motion
        nominal = self._nominal
        drive, (position, speed, acceleration) = self.moved(change)
        transmitted = (
            self._rigid(change, (position, speed, acceleration))
            + (change.armature - nominal.armature) * acceleration
            + (change.damping - nominal.damping) * speed
            + (change.stiffness - nominal.stiffness) * (position - self._robot.model.qpos_spring)
        )
        # what drives a geared joint transmits its torque, less what acts on that from outside
        transmitted = transmitted + (transmitted - motion.load) @ self._robot.geared
        if change.coupling.any() or change.play.any():  # rotors and dampers are the drives'
            transmitted -= change.armature * acceleration + change.damping * speed
            transmitted += transmitted @ change.coupling
            transmitted += change.armature * drive[2] + change.damping * drive[1]
        dry = self._slid(
            change.friction, change.presliding, change.stribeck, change.stribeck_speed
        )
        by_load = self._slid(
            change.load_friction,
            change.load_presliding,
            change.load_stribeck,
            change.load_stribeck_speed,
        )
        loss = by_load * np.sign(transmitted)
        at_drive = transmitted * np.exp(loss) * np.cosh(loss) ** change.load_side
        if change.capstan_friction.any():
            lost = self._tendons.lost(change, at_drive)
            at_drive = at_drive + lost + lost @ self._robot.geared
        at_drive = at_drive + dry + change.lopsided * change.damping * np.abs(motion.speed)
        if change.delay_s:
            at_drive = self._later(at_drive, change.delay_s)
        return np.asarray((1.0 + change.torque_scale) * at_drive + change.torque_offset)

    def _slid(
        self, friction: Array, presliding: Array, stribeck: Array, stribeck_speed: Array
    ) -> Array:
        """(R, J) torque of dry friction, (J,) in fast motion, along the motion."""
        friction_torque = np.zeros_like(self._motion.position)
        for j in np.flatnonzero(friction).tolist():
            more = Stribeck(float(stribeck[j]), float(stribeck_speed[j]))
            key = j, float(presliding[j]), more
            friction_torque[:, j] = friction[j] * self._slides.of(
                key, partial(self._motion.slid, *key)
            )
        return friction_torque

    def _rigid(self, change: Change, moved: tuple[Array, Array, Array]) -> Array:
        """Torques of the bodies, with the nominal model's springs, dampers and rotors."""
        elsewhere = change.key(*_OF_MOTION)
        if elsewhere == self._nominal.key(*_OF_MOTION):
            return self._by_inertia(change)
        key = (*elsewhere, *change.key(*_OF_BODIES))
        return self._cached.of(key, partial(self._whole, change, moved))

    def _whole(self, change: Change, moved: tuple[Array, Array, Array]) -> Array:
        nominal = self._nominal
        held = replace(
            change, armature=nominal.armature, damping=nominal.damping, stiffness=nominal.stiffness
        )
        return inverse_dynamics(self._robot.varied(held), *moved)

    @cached_property
    def _unchanged(self) -> Array:
        motion = self._motion
        return self._whole(self._nominal, (motion.position, motion.speed, motion.acceleration))

    def _by_inertia(self, change: Change) -> Array:
        """Linear in masses, first moments and inertias: exact, and quick."""
        torque = self._unchanged
        more = change.inertial_parameters() - self._nominal.inertial_parameters()
        for b in np.flatnonzero(more.any(axis=1)).tolist():
            torque = torque + self._columns.of((b,), partial(self._regressor, b)) @ more[b]
        return torque

    def _regressor(self, b: int) -> Array:
        """(R, J, 10) torques by a body's inertial parameters, from ten point masses on it."""
        robot = self._robot
        motion = self._motion
        light = copy.copy(robot.model)
        light.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SPRING
        light.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_DAMPER
        light.dof_armature[:] = 0.0
        bare = replace(robot, model=light).nominal()
        bare.mass_kg[:] = _LEAST_KG
        bare.inertia_kg_m2[:] = _LEAST_KG * np.eye(3)
        light_robot = replace(robot, model=light)
        moved = motion.position, motion.speed, motion.acceleration
        torques = []
        parameters = []
        for place in _PLACES:
            with_mass = bare.copied()
            with_mass.centre_m[b] = place
            with_mass.mass_kg[b] = 1.0
            torques.append(inverse_dynamics(light_robot.varied(with_mass), *moved))
            parameters.append(with_mass.inertial_parameters()[b])
        return np.einsum("kri,pk->rip", torques, np.linalg.inv(np.array(parameters)))

    def _later(self, torque: Array, delay_s: float) -> Array:
        motion = self._motion
        delayed = np.empty_like(torque)
        for t in np.unique(motion.trial):
            rows = motion.trial == t
            time_s = motion.time_s[rows]
            if len(time_s) < 4:
                delayed[rows] = torque[rows]
                continue
            earlier_s = np.clip(time_s - delay_s, time_s[0], time_s[-1])
            delayed[rows] = CubicSpline(time_s, torque[rows])(earlier_s)
        return delayed


class InverseComparison(MotionComparison):
    """Torques of the drives at rows, for the C joints that have one: motion in, torques out.

    Readings and predictions of a joint at rest are zero. Units are such that noise alone has a
    root mean square of one over all rows.
    """

    def __init__(self, robot: Robot, motion: Motion) -> None:
        """Take a robot and its motion as it was measured."""
        self._motion = motion
        self._dynamics = InverseDynamics(robot, motion)
        self._joints = np.flatnonzero(motion.counts.any(0))
        joints = self._joints
        self.names = tuple(robot.joints[j] for j in joints)
        self.columns = tuple(f"torque.{name}" for name in self.names)
        self.units = tuple(robot.torque_units[j] for j in joints)
        self.floor = motion.floor[joints]
        counted = motion.compared(np.ones_like(motion.torque))[:, joints]
        self.noise = self.floor * np.sqrt((counted**2).mean(0))
        self.readings = self._compared(motion.torque)
        self.trial = motion.compared_trial
        self.trial_labels = motion.compared_labels
        self.time_s = motion.compared_time_s
        self.description = (
            f"Compared by inverse dynamics: measured motion, smoothed to {motion.smoothed_hz:.3g} "
            f"Hz, in, torques out, with a bandwidth of {motion.compared_hz:.3g} Hz at "
            f"{len(self.trial):,} rows."
        )

    def predicted(self, change: Change) -> Array:
        """(Q, C) by a variant of the robot."""
        return self._compared(self._dynamics.torques(change))

    def conditions(self, change: Change) -> Conditions:
        """Position, speed and load (R, C) of channels at all rows, before the low-pass."""
        motion = self._motion
        load = self._dynamics.torques(change)
        return Conditions(motion.position, motion.speed, load, motion.acceleration).only(
            self._joints
        )

    def moved(self, change: Change) -> tuple[Array, Array]:
        """(R, C) positions and speeds of the channels' joints in a variant of the robot."""
        _, (position, speed, _) = self._dynamics.moved(change)
        return position[:, self._joints], speed[:, self._joints]

    def of_channels(self, by_joint: Array) -> Array:
        """Values (C,) by channel, of values (J,) by joint."""
        return by_joint[self._joints]

    def compared(self, column: Array) -> Array:
        """A function (R, C) of the conditions behind the low-pass of torques, (Q, C)."""
        whole = np.zeros_like(self._motion.position)
        whole[:, self._joints] = column
        return self._compared(whole)

    def _compared(self, torque: Array) -> Array:
        return self._motion.compared(torque)[:, self._joints]


class Servos(NamedTuple):
    """The model's position servos, by joint (J,).

    Attributes:
        per_command: position by unit of the command; `offset` is that of a command of zero.
        stiffness, damping: of the position, in torque.
    """

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
        model = robot.model
        servo = robot.servos
        if (servo < 0).any():
            lacking = [robot.joints[j] for j in np.flatnonzero(servo < 0)]
            raise RecordingError(
                f"{robot.path.name}: {some_of(lacking)} without a position servo; positions "
                "measured outside are compared with the commands of an actuator `position` at "
                "every joint"
            )
        gear = model.actuator_gear[model.actuator_outadr[servo], 0]
        bias = model.actuator_biasprm[servo]
        by_position = -bias[:, 1] * gear
        return Servos(
            per_command=model.actuator_gainprm[servo, 0] / by_position,
            offset=bias[:, 0] / by_position,
            stiffness=by_position * gear,
            damping=-bias[:, 2] * gear**2,
        )


class ServoComparison(MotionComparison):
    """Positions of all joints measured outside the drives less those commanded, at rows.

    A servo holds its own encoder at the command, except that it yields to the torque it bears. The
    zeros, scales, couplings and play between that encoder and the joint then show in a camera's
    positions, and in no torque.
    """

    def __init__(self, robot: Robot, motion: Motion) -> None:
        """The positions of `motion` are the joints'.

        Raises:
            RecordingError: a joint has no position servo.
        """
        self._motion = motion
        self._servos = Servos.of(robot)
        self._dynamics = InverseDynamics(robot, motion)
        servo_command = motion.command[:, robot.servo_controls]
        self._target = servo_command * self._servos.per_command + self._servos.offset
        self._play_motion = PlayMotion(robot, self._of_drives(robot))
        self.names = tuple(f"position.{joint}" for joint in robot.joints)
        self.columns = self.names
        self.units = robot.position_units
        noise = noise_of_smoothed(motion.noise.position, motion.compared_hz)
        self.floor = np.hypot(noise, _LEAST_OF_RANGE * motion.scale.position)
        self.noise = self.floor
        self.readings = motion.passed(motion.position - self._target)
        self.trial = motion.compared_trial
        self.trial_labels = motion.compared_labels
        self.time_s = motion.compared_time_s
        self.description = (
            "Positions measured outside the drives are compared with those that the servos' "
            "commands and the torques they bear make, with a bandwidth of "
            f"{motion.compared_hz:.3g} Hz at {len(self.trial):,} rows."
        )

    def predicted(self, change: Change) -> Array:
        """(Q, C) by a variant of the robot."""
        motion = self._motion
        servos = self._servos
        target = self._target
        if change.delay_s:
            trials = [motion.trial == t for t in np.unique(motion.trial)]
            late = [self._at(rows, motion.time_s[rows] + change.delay_s) for rows in trials]
            target = np.concatenate(late)
        yields = self._torque(change) + servos.damping * motion.speed
        drive = target - yields / (servos.stiffness * (1.0 + change.servo_gain))
        joint = drive + drive @ change.coupling.T
        if change.play.any():
            joint = joint + self._play_motion.moved(change.play)[0, self._play_motion.rows]
        read = change.zero + (1.0 + change.encoder_scale) * joint
        return motion.passed(read - self._target)

    def conditions(self, change: Change) -> Conditions:
        """Position, speed and load (Q, C) of each channel at the compared rows."""
        motion = self._motion
        parts = motion.position, motion.speed, self._torque(change), motion.acceleration
        return Conditions(*map(motion.passed, parts))

    def _of_drives(self, robot: Robot) -> Motion:
        """The motion of the drives: the measured one has gone through their play already."""
        motion = self._motion
        servos = self._servos
        trials = []
        for trial in motion.trials:
            command = smoothed(trial.command, motion.rate_hz, motion.smoothed_hz)
            target = command[:, robot.servo_controls] * servos.per_command + servos.offset
            speed, acceleration = derivatives(trial.position, motion.rate_hz)
            torque = inverse_dynamics(robot.model, trial.position, speed, acceleration)
            yields = (torque + servos.damping * speed) / servos.stiffness
            trials.append(replace(trial, position=target - yields))
        return replace(motion, trials=tuple(trials))

    def _torque(self, change: Change) -> Array:
        """(R, J) of the drives, with the joints where they were measured."""
        zeros = np.zeros_like(change.zero)
        still = np.zeros_like(change.coupling)
        at_joint = replace(
            change,
            coupling=still,
            play=zeros,
            torque_scale=zeros,
            torque_offset=zeros,
            delay_s=0.0,
        )
        torque = self._dynamics.torques(at_joint)
        return torque + torque @ change.coupling

    def _at(self, rows: Array, time_s: Array) -> Array:
        """Targets of a trial's rows at other times."""
        trial_s = self._motion.time_s[rows]
        return np.stack(
            [np.interp(time_s, trial_s, joint_target) for joint_target in self._target[rows].T],
            axis=1,
        )
