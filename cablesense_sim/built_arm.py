"""An arm as a workshop may have built it: unlike its file, but within the file's tolerances."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cablesense_base import Array
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import EffectEntry
from cablesense_sim.equilibrium import EquilibriumError, held_lengths_m, solve_equilibrium
from cablesense_sim.mechanism import LEAST_CABLE_SHARE, Mechanism
from cablesense_sim.tolerances import ArmParameters

_FRICTION = "capstan_friction"
_SCATTER_ARMS = 20
"""Draws by which the scatter of arms is told to within a sixth."""
_SCATTER_BEND_DEG = 10.0


@dataclass(frozen=True)
class BuiltArm:
    """What an arm of N segments and M cables is in truth, and nobody who reads its file knows.

    Attributes:
        mechanism: without the effects that the file lists.
        entries: these effects.
        joint_zeros_rad: (2N,) by which the held lengths are those of other angles than commanded.
        sensor_gain: (M,) share by which readings are too high.
        sensor_zero_n: (M,) what sensors read without a tension.
    """

    mechanism: Mechanism
    entries: list[EffectEntry]
    joint_zeros_rad: Array
    sensor_gain: Array
    sensor_zero_n: Array

    def read(self, tensions_n: Array) -> Array:
        """Readings (..., M) of tensions (..., M), without noise."""
        return (1.0 + self.sensor_gain) * tensions_n + self.sensor_zero_n


def as_described(arm: Arm) -> BuiltArm:
    """The arm that equals its file."""
    return BuiltArm(
        mechanism_of(arm),
        entries_of(arm),
        np.zeros(arm.joint_count),
        np.zeros(arm.cable_count),
        np.zeros(arm.cable_count),
    )


def built_arm(arm: Arm, seed: int) -> BuiltArm:
    """An arm with errors drawn within the tolerances of its file, always the same of a seed.

    Friction is only where the file lists it, then with a coefficient of its own. Centres of mass
    stay on the segments' axes, as a `Mechanism` has them.
    """
    entries = entries_of(arm)
    friction = [entry for entry in entries if entry.effect.name == _FRICTION]
    coefficient = friction[0].values["coefficient"] if friction else 0.0
    parameters = ArmParameters(mechanism_of(arm), arm.tolerances, coefficient)
    theta = parameters.drawn(np.random.default_rng(seed))
    slices = parameters.slices
    if friction:
        drawn = float(theta[slices["friction"]][0])
        entries = [
            replace(entry, values=entry.values | {"coefficient": drawn})
            if entry.effect.name == _FRICTION
            else entry
            for entry in entries
        ]
    mechanism = parameters.built(theta)
    in_series = mechanism.stiffness_n_m
    by_cable = 1.0 / in_series - 1.0 / mechanism.actuator_stiffness_n_m
    cable_alone = 1.0 / np.maximum(by_cable, LEAST_CABLE_SHARE / in_series)
    return BuiltArm(
        replace(mechanism, cable_stiffness_n_m=cable_alone),
        entries,
        parameters.joint_zeros_rad(theta),
        theta[slices["sensor_gain"]],
        theta[slices["sensor_zero"]],
    )


def unloaded_scatter_n(arm: Arm) -> float | None:
    """By how much arms that are built within a file's tolerances read otherwise than it says, N.

    Root mean square over cables and arms, untouched, in poses within 10 degrees; before any tare,
    and without the effects that the file lists. None where no such arm finds rest.
    """
    nominal = mechanism_of(arm)
    bend_rad = np.deg2rad(_SCATTER_BEND_DEG)
    squares_n2 = []
    for seed in range(_SCATTER_ARMS):
        built = built_arm(arm, seed)
        rng = np.random.default_rng(seed)
        command_rad = rng.uniform(-bend_rad, bend_rad, arm.joint_count)
        held_m = held_lengths_m(nominal, command_rad + built.joint_zeros_rad)
        try:
            of_file_n = solve_equilibrium(nominal, command_rad).tensions_n
            of_built_n = solve_equilibrium(built.mechanism, command_rad, held_m=held_m).tensions_n
        except EquilibriumError:
            continue
        squares_n2.append(np.mean((built.read(of_built_n) - of_file_n) ** 2))
    return float(np.sqrt(np.mean(squares_n2))) if squares_n2 else None
