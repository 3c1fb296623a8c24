"""An arm whose effects depend on the past, as the sim node runs it: from rest to rest.

A cable that sticks or a joint that does must hold at rest and not creep. As a force in time that
is a stiffness of megapascals over micrometres, which an explicit step does not bear, and a
regularised one creeps. Between two moments this arm therefore comes to rest at once, with the
state that it had kept; there is no swinging. It does so when it is looked at, and no sooner than
`LEAST_PERIOD_S` after the last time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablesense_sim.arm import Arm
from cablesense_sim.command import actuated_m, checked_command
from cablesense_sim.effects.chains import actuations, amended
from cablesense_sim.effects.entry import entries_of
from cablesense_sim.equilibrium import EquilibriumError
from cablesense_sim.loads import checked_load
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.quasi_static import QuasiStaticArm

Array = NDArray[np.float64]

LEAST_PERIOD_S = 0.02
"""A rest takes some milliseconds to find; fast sensors read the same one several times."""

_ROUNDING_S = 1e-9


class RestToRestArm:
    """One arm with what `ArmDynamics` has, but without motion between its rests.

    Attributes:
        arm: the description it was built from.
        mechanism: its numbers as arrays, as its effects leave them.
    """

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self._entries = entries_of(arm)
        self._nominal = Mechanism.from_arm(arm)
        self.mechanism = amended(self._nominal, self._entries)
        self._forces_n = np.zeros((arm.segment_count, 3))
        self.reset()

    def reset(self, command_rad: ArrayLike | None = None) -> None:
        """Rest, unloaded, at a command (2N,), straight by default; without a past, at time zero.

        Raises:
            EquilibriumError: as `command`, or the arm finds no rest there.
        """
        command = self.checked_command(
            np.zeros(self.arm.joint_count) if command_rad is None else command_rad
        )
        actuating = actuations([self._entries])
        held = actuated_m(self._nominal, command, actuating, 0.0)
        resting = QuasiStaticArm([self.mechanism], [self._entries])
        tensions = resting.step(0.0, held[None], np.zeros_like(self._forces_n))[0]
        self._actuations, self._resting = actuating, resting
        self._command_rad, self._held_m, self._tensions_n = command, held, tensions
        self._forces_n[:] = 0.0
        self._time_s = self._rested_s = 0.0

    def command(self, joint_angles_rad: ArrayLike) -> None:
        """Let the actuators hold the cable lengths of these joint angles (2N,).

        They are those of the arm without its effects: its controller knows no better.

        Raises:
            EquilibriumError: wrong shape, not finite, or a bend at which guide plates would touch.
        """
        command = self.checked_command(joint_angles_rad)
        self._held_m = actuated_m(self._nominal, command, self._actuations, self._time_s)
        self._command_rad = command

    def checked_command(self, joint_angles_rad: ArrayLike) -> Array:
        """Joint angles (2N,) that the arm can be commanded to; changes nothing.

        Raises:
            EquilibriumError: as `command`.
        """
        return checked_command(self._nominal, joint_angles_rad)

    def load(self, segment: int, force_base_n: ArrayLike) -> None:
        """Push segment 1..N at its contact point with a force (3,) in base axes, N, from now on.

        Raises:
            LoadError: no such segment, or a force that is not three finite numbers.
        """
        self._forces_n[segment - 1] = checked_load(self._nominal, segment, force_base_n)

    def advance(self, duration_s: float) -> None:
        """Let time pass."""
        self._time_s += duration_s

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return self._time_s

    @property
    def command_rad(self) -> Array:
        """(2N,) commanded joint angles."""
        return self._command_rad.copy()

    @property
    def forces_n(self) -> Array:
        """(N, 3) loads in force, base axes."""
        return self._forces_n.copy()

    @property
    def joint_angles_rad(self) -> Array:
        """(2N,) true joint angles."""
        self._come_to_rest()
        return self._resting.joint_angles_rad[0]

    @property
    def tensions_n(self) -> Array:
        """(M,) true cable tensions at the actuators; NaN where the arm finds no rest."""
        self._come_to_rest()
        return self._tensions_n.copy()

    def _come_to_rest(self) -> None:
        if self._time_s - self._rested_s < LEAST_PERIOD_S - _ROUNDING_S:
            return
        self._rested_s = self._time_s
        try:
            self._tensions_n = self._resting.step(
                self._time_s, self._held_m[None], self._forces_n
            )[0]
        except EquilibriumError:
            self._tensions_n = np.full(self.arm.cable_count, np.nan)
