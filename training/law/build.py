"""Builds the estimator of an arm from its file, and runs it in PyTorch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_base import Array
from cablesense_contact.law import LawOutput
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import amended, joint_zeros_rad, sensings
from cablesense_sim.replay import reading_variance_n2
from cablesense_sim.touch import touched_places
from cablesense_sim.uncertain_arm import arm_parameters, cable_friction
from cablesense_training.law.estimator import ArmEstimator, EstimatorOutput
from cablesense_training.law.geometry import constant


class _ListedSensing(NamedTuple):
    """What the effects in an arm file make of tensions and commands, beside the arm's body.

    Attributes:
        mixing: (M, M) and
        zero_n: (M,) of readings that have settled: mixing @ tensions + zeros.
        mean: (P,) the parameters that the file lists: joint zeros.
    """

    mixing: Array
    zero_n: Array
    mean: Array

    @property
    def is_perfect(self) -> bool:
        """Whether the file lists no such effect."""
        unmixed = np.array_equal(self.mixing, np.eye(len(self.mixing)))
        return unmixed and not self.zero_n.any() and not self.mean.any()


class _SensedEstimator(nn.Module):
    """The estimator behind the sensors and joint zeros that an arm file lists.

    Readings are taken back to those of sensors as they should be; parameters are deviations from
    what the file lists.
    """

    def __init__(self, estimator: ArmEstimator, listed: _ListedSensing) -> None:
        super().__init__()
        self.estimator = estimator
        self.unmixing = constant(np.linalg.inv(listed.mixing).T)
        self.zero_n = constant(listed.zero_n)
        self.mean = constant(listed.mean)

    def forward(
        self,
        reading_n: Tensor,
        command_rad: Tensor,
        mean: Tensor,
        covariance: Tensor,
        unrest_n2_m2: Tensor,
    ) -> EstimatorOutput:
        """The posterior, as `ArmEstimator` gives it, of readings (B, M) of those sensors."""
        right_n = (reading_n - self.zero_n) @ self.unmixing
        return self.estimator(right_n, command_rad, mean + self.mean, covariance, unrest_n2_m2)


def arm_estimator(
    arm: Arm, unexplained_n2: Array | None = None
) -> ArmEstimator | _SensedEstimator:
    """The estimator of an arm: as drawn, with the effects that its file lists.

    Of effects without memory it knows all, of the others the friction of cables. `unexplained_n2`
    (M, M) is the covariance of readings by what it does not know, N².
    """
    nominal = mechanism_of(arm)
    estimator = ArmEstimator(
        amended(nominal, entries_of(arm)),
        nominal,
        arm_parameters(arm),
        reading_variance_n2(arm.sensors),
        cable_friction(arm),
        touched_places(arm),
        unexplained_n2=unexplained_n2,
    )
    listed = _listed_sensing(arm)
    return estimator if listed.is_perfect else _SensedEstimator(estimator, listed)


def _listed_sensing(arm: Arm) -> _ListedSensing:
    """Sensors without memory are affine in the tensions; others are taken as they settle."""
    entries = entries_of(arm)
    cables = arm.cable_count
    tensions_n = np.concatenate([np.zeros((1, cables)), np.eye(cables)])
    readings_n = tensions_n
    for sensing in sensings([entries] * len(tensions_n)):
        readings_n = sensing.step(0.0, readings_n)
    zero_n = readings_n[0]
    parameters = arm_parameters(arm)
    mean = np.zeros(len(parameters))
    zeros_rad = joint_zeros_rad([entries], arm.segment_count)
    if zeros_rad is not None:
        mean[parameters.slices["joint_zero"]] = zeros_rad[0]
    return _ListedSensing((readings_n[1:] - zero_n).T, zero_n, mean)


class TorchLaw:
    """The law of an arm in PyTorch; a `cablesense_contact.law.Law`.

    Attributes:
        arm: the arm.
        estimator: the module that answers.
    """

    most_together = 1

    def __init__(self, arm: Arm, unexplained_n2: Array | None = None) -> None:
        """Build it; see `arm_estimator`."""
        self.arm = arm
        self.estimator = arm_estimator(arm, unexplained_n2).double().eval()

    def __call__(
        self,
        reading_n: Array,
        command_rad: Array,
        mean: Array,
        covariance: Array,
        unrest_n2_m2: Array,
    ) -> LawOutput:
        """What readings (B, M) say at commands (B, 2N), by parameters with a mean (P,).

        The parameters have the covariance (P, P), torques by motion `unrest_n2_m2` (2N, 2N).
        """
        inputs = (reading_n, command_rad, mean, covariance, unrest_n2_m2)
        with torch.no_grad():
            answer = self.estimator(
                *(torch.as_tensor(np.asarray(each, dtype=float)) for each in inputs)
            )
        return LawOutput._make(np.asarray(part.numpy()) for part in answer)
