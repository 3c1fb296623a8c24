"""Measured motion in, torques out: what the model says the drives must have given.

Nothing is integrated, so nothing drifts.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, partial

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from cablesense_base import Array
from cablesense_gap.diagnosis.discrepancy import Conditions
from cablesense_gap.robot import smoothing
from cablesense_gap.robot.model import Change, Robot, inverse_dynamics
from cablesense_gap.robot.motion import Motion, MotionComparison, Recent, Trajectory
from cablesense_gap.robot.tendons import GuidedTendons

_OF_BODIES = ("mass_kg", "centre_m", "inertia_kg_m2")
_OF_MOTION = ("gravity_m_s2", "zero", "encoder_scale", "coupling", "play")
_LEAST_KG = _LEAST_KG_M2 = 1e-9
_PLACES = np.array([*np.zeros((1, 3)), *np.eye(3), *-np.eye(3), *(1.0 - np.eye(3))])
"""Of point masses, m; their inertial parameters are independent."""


class InverseDynamics:
    """Torques that variants of a robot need for one motion."""

    def __init__(self, robot: Robot, motion: Trajectory) -> None:
        """`motion` is a measured or a planned one."""
        self._robot, self._motion = robot, motion
        self._nominal = robot.nominal()
        self._gaps = BacklashMotion(robot, motion) if isinstance(motion, Motion) else None
        self._tendons = GuidedTendons(robot, motion)
        self._cached, self._slides, self._columns = Recent(), Recent(), Recent()

    def torques(self, change: Change) -> Array:
        """(R, J) as the drives' torques would be read."""
        motion, nominal, true = self._motion, self._nominal, 1.0 + change.encoder_scale
        drive = (
            (motion.position - change.zero) / true,
            motion.speed / true,
            motion.acceleration / true,
        )
        behind: Array | Sequence[float] = (0.0, 0.0, 0.0)
        if self._gaps is not None and change.play.any():
            behind = self._gaps.moved(change.play, rows_alone=True)
        position, speed, acceleration = (
            each + each @ change.coupling.T + gap for each, gap in zip(drive, behind, strict=True)
        )
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
        dry = self._slid(change.friction, change.presliding)
        by_load = self._slid(change.load_friction, change.load_presliding)
        loss = by_load * np.sign(transmitted)
        at_drive = transmitted * np.exp(loss) * np.cosh(loss) ** change.load_side
        if change.capstan_friction.any():
            lost = self._tendons.lost(change, at_drive)
            at_drive = at_drive + lost + lost @ self._robot.geared
        at_drive = at_drive + dry
        if change.delay_s:
            at_drive = self._later(at_drive, change.delay_s)
        return np.asarray((1.0 + change.torque_scale) * at_drive + change.torque_offset)

    def _slid(self, friction: Array, presliding: Array) -> Array:
        """(R, J) torque of dry friction, at most (J,), along the motion."""
        found = np.zeros_like(self._motion.position)
        for j in np.flatnonzero(friction).tolist():
            key = j, float(presliding[j])
            found[:, j] = friction[j] * self._slides.of(key, partial(self._motion.slid, *key))
        return found

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


class InverseComparison(MotionComparison):
    """Torques of those joints that have one, see `MotionComparison`.

    Readings and predictions of a joint at rest are zero. Units are such that noise alone has a
    root mean square of one over all rows.
    """

    def __init__(self, robot: Robot, motion: Motion) -> None:
        """`motion` is what was measured."""
        self._motion, self._dynamics = motion, InverseDynamics(robot, motion)
        self._joints = joints = np.flatnonzero(motion.counts.any(0))
        self.names = tuple(robot.joints[j] for j in joints)
        self.columns = tuple(f"torque.{name}" for name in self.names)
        self.units = tuple(robot.torque_units[j] for j in joints)
        self.floor = motion.floor[joints]
        counted = motion.compared(np.ones_like(motion.torque))[:, joints]
        self.noise = self.floor * np.sqrt((counted**2).mean(0))
        self.readings = self._compared(motion.torque)
        self.trial, self.time_s = motion.compared_trial, motion.compared_time_s
        self.description = (
            f"Compared by inverse dynamics: measured motion, smoothed to {motion.smoothed_hz:.3g} "
            f"Hz, in, torques out, with a bandwidth of {motion.compared_hz:.3g} Hz at "
            f"{len(self.trial):,} rows."
        )

    def predicted(self, change: Change) -> Array:
        """(Q, C) by a variant of the robot."""
        return self._compared(self._dynamics.torques(change))

    def conditions(self, change: Change) -> Conditions:
        """At the motion's rows, before the low-pass."""
        motion, load = self._motion, self._dynamics.torques(change)
        return Conditions(
            *(each[:, self._joints] for each in (motion.position, motion.speed, load))
        )

    def compared(self, column: Array) -> Array:
        """As torques are."""
        whole = np.zeros_like(self._motion.position)
        whole[:, self._joints] = column
        return self._compared(whole)

    def _compared(self, torque: Array) -> Array:
        return self._motion.compared(torque)[:, self._joints]


class BacklashMotion:
    """Motion of joints relative to their drives, within the gaps that backlash leaves.

    It follows from motion measured at the drives, and the model. A joint lies at that end of its
    gap at which the drive gives the torque that the link needs. The link moves freely to the other
    end when that torque changes its sign.
    """

    def __init__(self, robot: Robot, motion: Motion) -> None:
        """`motion` is what was measured."""
        self._robot, self._motion = robot, motion
        self._known = Recent()

    @cached_property
    def _free_acceleration(self) -> tuple[Array, ...]:
        """By trial, accelerations (T, J) of freely moving joints relative to their drives."""
        model = copy.copy(self._robot.model)
        inertia = np.maximum(self._motion.inertia - model.dof_armature, _LEAST_KG_M2)
        model.dof_armature[:], model.dof_damping[:] = 0.0, 0.0
        rate_hz = self._motion.rate_hz
        return tuple(
            -inverse_dynamics(model, path, *smoothing.derivatives(path, rate_hz)) / inertia
            for path in self._motion.paths
        )

    def moved(self, play: Array, *, rows_alone: bool = False) -> Array:
        """Positions, speeds and accelerations (3, ΣT, J) of joints from drives, smoothed alike.

        With `rows_alone` those of the motion's R rows.
        """
        found = np.zeros((3, sum(map(len, self._motion.paths)), len(play)))
        for j in np.flatnonzero(play).tolist():
            key = j, float(play[j])
            found[:, :, j] = self._known.of(key, partial(self._of_joint, *key))
        return found[:, self._motion.rows] if rows_alone else found

    def _of_joint(self, joint: int, play: float) -> Array:
        motion, found = self._motion, []
        for free in self._free_acceleration:
            gap = _place_in_gap(free[:, joint], 0.5 * play, 1.0 / motion.rate_hz)[:, None]
            smooth = smoothing.smoothed(gap, motion.rate_hz, motion.smoothed_hz)
            moved = smooth, *smoothing.derivatives(smooth, motion.rate_hz)
            found.append(np.hstack(moved).T)
        return np.concatenate(found, 1)


def _place_in_gap(acceleration: Array, reach: float, interval_s: float) -> Array:
    """(T,) positions within ±`reach` of a joint that moves freely with an acceleration (T,)."""
    place, speed, found = float(np.sign(acceleration[0])) * reach, 0.0, []
    for each in acceleration.tolist():
        speed += each * interval_s
        place += speed * interval_s
        if abs(place) >= reach:
            place, speed = (reach if place > 0.0 else -reach), 0.0
        found.append(place)
    return np.array(found)
