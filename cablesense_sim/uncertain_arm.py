"""What is uncertain about the arm of a file, and what the file says of its cables' friction."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.transmission import CapstanFriction, run_compliance
from cablesense_sim.tolerances import ArmParameters

_UNLISTED_PULLEY_RAD = 1.0
"""Wrap at the actuators of an arm whose file lists no friction."""
_UNLISTED_RUN_COMPLIANCE = 0.5
"""Its compliance before the pulley over that behind: drive, sensor and a short piece of cable."""


class CableFriction(NamedTuple):
    """Where the cables of an arm rub, and how much.

    Attributes:
        coefficient: zero where the file lists no friction.
        pulley_wrap_rad, guide_wrap_rad: by which a cable turns with the arm straight, at the
            actuator and between two joints.
        run_compliance: (M,) of a cable before the pulley, over that behind it.
    """

    coefficient: float
    pulley_wrap_rad: float
    guide_wrap_rad: float
    run_compliance: Array

    @property
    def listed(self) -> bool:
        """Whether the file lists friction."""
        return self.coefficient > 0.0


def cable_friction(arm: Arm) -> CableFriction:
    """The friction that an arm file lists, or how an arm rubs whose file lists none."""
    for entry in entries_of(arm):
        if entry.effect.name == CapstanFriction.name:
            values = entry.values
            ratio = run_compliance(
                mechanism_of(arm), values["run_compliance"], values["run_by_length"]
            )
            return CableFriction(
                values["coefficient"], values["pulley_wrap_rad"], values["guide_wrap_rad"], ratio
            )
    ratio = np.full(arm.cable_count, _UNLISTED_RUN_COMPLIANCE)
    return CableFriction(0.0, _UNLISTED_PULLEY_RAD, 0.0, ratio)


def arm_parameters(arm: Arm) -> ArmParameters:
    """The uncertain parameters of an arm, by its file."""
    return ArmParameters(mechanism_of(arm), arm.tolerances, cable_friction(arm).coefficient)
