"""An arm as a workshop may have built it: unlike its file, but within the file's tolerances."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cablesense_base import Array
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import EffectEntry
from cablesense_sim.mechanism import LEAST_CABLE_SHARE, Mechanism
from cablesense_sim.tolerances import ArmParameters

_FRICTION = "capstan_friction"


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
