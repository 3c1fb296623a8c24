"""Builds the estimator of an arm from its file, and runs it in PyTorch."""

from __future__ import annotations

import numpy as np
import torch

from cablesense_base import Array
from cablesense_contact.calibration import parameters_of
from cablesense_contact.law import LawOutput
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import amended
from cablesense_sim.replay import reading_variance_n2
from cablesense_sim.touch import touched_places
from cablesense_training.law.estimator import ArmEstimator
from cablesense_training.law.measurement import FrictionWraps

UNLISTED_PULLEY_RAD = 1.0
"""Wrap at the actuators of an arm whose file lists no friction."""


def arm_estimator(arm: Arm) -> ArmEstimator:
    """The estimator of an arm: as drawn, with the effects on its body that its file lists."""
    nominal = mechanism_of(arm)
    places = touched_places(arm)
    return ArmEstimator(
        amended(nominal, entries_of(arm)),
        nominal,
        parameters_of(arm),
        reading_variance_n2(arm.sensors),
        friction_wraps(arm),
        places.reach_m,
        places.radius_m,
        places.friction,
    )


def friction_wraps(arm: Arm) -> FrictionWraps:
    """Where cables turn with the arm straight, by the friction that the arm file lists."""
    for entry in entries_of(arm):
        if entry.effect.name == "capstan_friction":
            return FrictionWraps(entry.values["pulley_wrap_rad"], entry.values["guide_wrap_rad"])
    return FrictionWraps(UNLISTED_PULLEY_RAD, 0.0)


class TorchLaw:
    """The law of an arm in PyTorch; a `cablesense_contact.law.Law`."""

    def __init__(self, arm: Arm) -> None:
        self._estimator = arm_estimator(arm).double().eval()

    def __call__(
        self,
        reading_n: Array,
        command_rad: Array,
        mean: Array,
        covariance: Array,
        unrest_n2_m2: Array,
    ) -> LawOutput:
        """See `Law`."""
        given = (reading_n, command_rad, mean, covariance, unrest_n2_m2)
        with torch.no_grad():
            answer = self._estimator(
                *(torch.as_tensor(np.asarray(each, dtype=float)) for each in given)
            )
        return LawOutput._make(np.asarray(part.numpy()) for part in answer)
