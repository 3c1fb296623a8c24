"""An arm that is commanded and loaded in time: stepped by MuJoCo, or quasi-static.

`ArmDynamics` steps MuJoCo, with the effects on the arm itself and on its actuators. A cable or a
joint that sticks must hold at rest and not creep. As a force in time that is a stiffness of
megapascals over micrometres, which an explicit step does not bear, and a regularised one creeps.
An arm with history-dependent effects is therefore an `ArmQuasiStatics`: in equilibrium at once,
with the state that it had kept, and there is no swinging.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from cablesense_base import Array
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.built_arm import BuiltArm, as_described
from cablesense_sim.effects.effect import Actuation
from cablesense_sim.effects.registry import actuations, amended, joint_zeros_rad, transmissions
from cablesense_sim.equilibrium import (
    EquilibriumError,
    checked_command,
    held_lengths_m,
    solve_equilibrium,
)
from cablesense_sim.loads import LoadError
from cablesense_sim.model import build_spec

LEAST_PERIOD_S = 0.01
"""A rest takes some milliseconds to find; fast sensors read the same one several times."""

_ROUNDING_S = 1e-9
"""By which sums of time steps differ from their multiple."""
_SLIGHTLY_M = 1e-6
"""Cable paid out for an equilibrium elsewhere: far below any reading's error."""


def moving_arm(
    arm: Arm, timestep_s: float, built: BuiltArm | None = None
) -> ArmDynamics | ArmQuasiStatics:
    """The arm of a file with its effects, as it was `built`; its sensors are left to who reads.

    Raises:
        EquilibriumError: it has no equilibrium under its own weight.
    """
    if transmissions([entries_of(arm)]):
        return ArmQuasiStatics(arm, built)
    return ArmDynamics(arm, timestep_s, built)


class _CommandedArm(ABC):
    """What both kinds of arm have: description, command and loads.

    Attributes:
        arm: its description, by which its controller knows it.
        built: by what it differs from that.
        mechanism: its numbers as arrays, as its effects leave them.
    """

    def __init__(self, arm: Arm, built: BuiltArm | None = None) -> None:
        """Without `built` the arm equals its description."""
        self.arm = arm
        self.built = built or as_described(arm)
        self._entries = self.built.entries
        self._nominal = mechanism_of(arm)
        self.mechanism = amended(self.built.mechanism, self._entries)
        self._forces_n = np.zeros((arm.segment_count, 3))
        self._places_m = self.mechanism.contact_m.copy()
        self._command_rad = np.zeros(arm.joint_count)
        self._offset_m = np.zeros(arm.cable_count)
        self._actuations = actuations([self._entries])

    @property
    @abstractmethod
    def time_s(self) -> float:
        """Simulated time."""

    @abstractmethod
    def _hold(self, held_m: Array) -> None:
        """Let the actuators hold cable lengths (M,), relative to the straight arm."""

    def command(self, joint_angles_rad: ArrayLike) -> None:
        """Let the actuators hold the cable lengths of these joint angles (2N,).

        They are those of the arm as described and without effects: its controller knows no better.

        Raises:
            EquilibriumError: wrong shape, not finite, or a bend at which guide plates would touch.
        """
        self._command_rad = self.checked_command(joint_angles_rad)
        self._hold(self._actuated_m(self._command_rad, self._actuations, self.time_s))

    def offset(self, lengths_m: Array) -> None:
        """Let the actuators hold cables longer by lengths (M,) than the command's."""
        self._offset_m = lengths_m
        self._hold(self._actuated_m(self._command_rad, self._actuations, self.time_s))

    def _actuated_m(
        self, command_rad: Array, through: Sequence[Actuation], time_s: float
    ) -> Array:
        angles_rad = command_rad + self.built.joint_zeros_rad
        zeros_rad = joint_zeros_rad([self._entries], self.arm.segment_count)
        if zeros_rad is not None:
            angles_rad = angles_rad + zeros_rad[0]
        held = held_lengths_m(self._nominal, angles_rad)[None] + self._offset_m
        for actuation in through:
            held = actuation.step(time_s, held)
        return np.asarray(held[0])

    def checked_command(self, joint_angles_rad: ArrayLike | None) -> Array:
        """Joint angles (2N,) that the arm can be commanded to, straight if None.

        Raises:
            EquilibriumError: as `command`.
        """
        straight = np.zeros(self.arm.joint_count)
        angles = straight if joint_angles_rad is None else joint_angles_rad
        return checked_command(self._nominal, angles)

    def load(self, segment: int, force_base_n: ArrayLike, contact_m: float | None = None) -> None:
        """Push segment 1..N with a force (3,) in base axes, N, from now on.

        It acts on the segment's axis, at `contact_m` from its joint centre, or at the contact
        point if that is None; elsewhere, if one of the arm's effects says so of stated places.

        Raises:
            LoadError: no such segment or place, or a force that is not three finite numbers.
        """
        force = np.asarray(force_base_n, dtype=float)
        if not 1 <= segment <= self.arm.segment_count:
            raise LoadError(f"no segment {segment}; this arm has 1 to {self.arm.segment_count}")
        if force.shape != (3,) or not np.isfinite(force).all():
            raise LoadError(f"a load is three finite force components in N, not {force!r}")
        n = segment - 1
        stated_m = self._nominal.contact_m[n]
        length_m = self._nominal.segment_length_m[n]
        further_m = 0.0 if contact_m is None else contact_m - stated_m
        if not 0.0 <= stated_m + further_m <= length_m:
            raise LoadError(
                f"a load at {contact_m} m is not on segment {segment}: from 0 to {length_m:g} m"
            )
        self._forces_n[n] = force
        self._places_m[n] = self.mechanism.contact_m[n] + further_m

    @property
    def forces_n(self) -> Array:
        """(N, 3) loads in force, base axes."""
        return self._forces_n.copy()

    @property
    def command_rad(self) -> Array:
        """(2N,) commanded joint angles."""
        return self._command_rad.copy()


class ArmDynamics(_CommandedArm):
    """One arm that moves in time; starts at rest under its own weight, straight command.

    Attributes:
        model, data: MuJoCo's own, for rendering.
    """

    def __init__(self, arm: Arm, timestep_s: float = 1e-3, built: BuiltArm | None = None) -> None:
        """Build the model.

        Raises:
            EquilibriumError: the arm has history-dependent effects, or no equilibrium.
        """
        super().__init__(arm, built)
        if transmissions([self._entries]):
            raise EquilibriumError(
                f"arm {arm.identity} has history-dependent effects; it goes from rest to rest "
                "(cablesense_sim.dynamics.ArmQuasiStatics), not in time"
            )
        self.model = build_spec(self.mechanism, arm.name).compile()
        self.model.opt.timestep = timestep_s
        self.data = mujoco.MjData(self.model)
        self._rigid = not np.isfinite(self.mechanism.actuator_stiffness_n_m)
        numbers = range(1, arm.segment_count + 1)
        self._segments = np.array([self.model.body(f"segment_{n}").id for n in numbers])
        self._joints = np.array([self.model.joint(name).qposadr[0] for name in arm.joint_names])
        self.reset()

    def reset(self, command_rad: ArrayLike | None = None) -> None:
        """Rest, unloaded, at a command (2N,), straight by default; time starts again at zero."""
        command = self.checked_command(command_rad)
        self._offset_m = np.zeros(self.arm.cable_count)
        fresh = actuations([self._entries])
        held = self._actuated_m(command, fresh, 0.0)
        equilibrium = solve_equilibrium(self.mechanism, command, held_m=held)
        mujoco.mj_resetData(self.model, self.data)
        self._forces_n[:] = 0.0
        self._actuations = fresh
        self.command(command)
        self.data.qpos[self._joints] = equilibrium.joint_angles_rad
        if not self._rigid:
            sag = equilibrium.tensions_n / self.mechanism.actuator_stiffness_n_m
            for i, retraction in enumerate(self.data.ctrl - sag):
                self.data.joint(f"screw_{i + 1}").qpos = retraction
        mujoco.mj_forward(self.model, self.data)

    def _hold(self, held_m: Array) -> None:
        if self._rigid:
            self.data.mocap_pos[:, 0] = -self.mechanism.run_m + held_m
        else:
            self.data.ctrl[:] = -held_m

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return float(self.data.time)

    @property
    def joint_angles_rad(self) -> Array:
        """(2N,) true joint angles."""
        return self.data.qpos[self._joints].copy()

    @property
    def tensions_n(self) -> Array:
        """(M,) true cable tensions at the actuators."""
        stretch = self.data.ten_length - self.model.tendon_lengthspring[:, 1]
        return np.asarray(np.maximum(self.mechanism.cable_stiffness_n_m * stretch, 0.0))

    def advance(self, duration_s: float) -> None:
        """Step time by `duration_s`, rounded to whole steps, at least one."""
        for _ in range(max(1, round(duration_s / self.model.opt.timestep))):
            self._step()
        self._measure_tendons()

    def settle(self, speed_rad_s: float = 1e-9, longest_s: float = 60.0) -> int:
        """Step until the joints move slower than `speed_rad_s`; gives the number of steps.

        Raises:
            EquilibriumError: still moving after `longest_s` of simulated time.
        """
        for steps in range(1, round(longest_s / self.model.opt.timestep) + 1):
            self._step()
            if np.abs(self.data.qvel).max() < speed_rad_s:
                self._measure_tendons()
                return steps
        raise EquilibriumError(f"the arm still moves after {longest_s} s of simulated time")

    def _step(self) -> None:
        """MuJoCo takes forces at centres of mass; a force elsewhere brings its moment along."""
        axis = self.data.xmat[self._segments].reshape(-1, 3, 3)[..., 0]
        contact = self.data.xpos[self._segments] + self._places_m[:, None] * axis
        arm = contact - self.data.xipos[self._segments]
        self.data.xfrc_applied[self._segments, :3] = self._forces_n
        self.data.xfrc_applied[self._segments, 3:] = np.cross(arm, self._forces_n)
        mujoco.mj_step(self.model, self.data)

    def _measure_tendons(self) -> None:
        """A step leaves cable lengths as they were at its start; take them where it ended."""
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_tendon(self.model, self.data)


class ArmQuasiStatics(_CommandedArm):
    """One arm without motion between its equilibria.

    It comes to rest when it is read, and no sooner than `LEAST_PERIOD_S` after the last time.
    """

    def __init__(self, arm: Arm, built: BuiltArm | None = None) -> None:
        super().__init__(arm, built)
        self._time_s = 0.0
        self.reset()
        # an equilibrium elsewhere has all code compiled or loaded before time runs
        self._quasi_static.step(0.0, self._held_m[None] + _SLIGHTLY_M, self._forces_n)
        self.reset()

    def reset(self, command_rad: ArrayLike | None = None) -> None:
        """Rest, unloaded, at a command (2N,), straight by default; without a past, at time zero.

        Raises:
            EquilibriumError: as `command`, or the arm finds no equilibrium there.
        """
        from cablesense_sim.quasi_static import QuasiStaticArm  # compiled: others need not wait

        command = self.checked_command(command_rad)
        self._offset_m = np.zeros(self.arm.cable_count)
        actuating = actuations([self._entries])
        held = self._actuated_m(command, actuating, 0.0)
        resting = QuasiStaticArm([self.mechanism], [self._entries])
        tensions = resting.step(0.0, held[None], np.zeros_like(self._forces_n))[0]
        self._actuations = actuating
        self._quasi_static = resting
        self._command_rad = command
        self._held_m = held
        self._tensions_n = tensions
        self._forces_n[:] = 0.0
        self._time_s = 0.0
        self._solved_s = 0.0

    def _hold(self, held_m: Array) -> None:
        self._held_m = held_m

    def advance(self, duration_s: float) -> None:
        """Let time pass, with command and loads as they are."""
        self._time_s += duration_s

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return self._time_s

    @property
    def joint_angles_rad(self) -> Array:
        """(2N,) true joint angles."""
        self._find_equilibrium()
        return self._quasi_static.joint_angles_rad[0]

    @property
    def tensions_n(self) -> Array:
        """(M,) true cable tensions at the actuators; NaN where the arm finds no equilibrium."""
        self._find_equilibrium()
        return self._tensions_n.copy()

    def _find_equilibrium(self) -> None:
        if self._time_s - self._solved_s < LEAST_PERIOD_S - _ROUNDING_S:
            return
        self._solved_s = self._time_s
        try:
            tensions = self._quasi_static.step(
                self._time_s, self._held_m[None], self._forces_n, self._places_m
            )
            self._tensions_n = tensions[0]
        except EquilibriumError:
            self._tensions_n = np.full(self.arm.cable_count, np.nan)
