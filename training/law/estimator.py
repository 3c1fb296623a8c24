"""The whole estimator as one module: reading, command and calibration in, a posterior out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from torch import Tensor, nn

from cablesense_base import Array
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.tolerances import ArmParameters
from cablesense_sim.touch import TouchedPlaces
from cablesense_sim.uncertain_arm import CableFriction
from cablesense_training.law.evidence import evidence_of
from cablesense_training.law.hypotheses import torque_scale_of
from cablesense_training.law.measurement import POSE_STEPS, MeasurementModel
from cablesense_training.law.statement import ContactStatement


class EstimatorOutput(NamedTuple):
    """What B readings say, as tensors: each is described at `cablesense_contact.law.LawOutput`."""

    contact_evidence: Tensor
    segment_evidence: Tensor
    several_evidence: Tensor
    faulty_evidence: Tensor
    faulty_segment_evidence: Tensor
    exchanged_evidence: Tensor
    free_chi2: Tensor
    contact_chi2: Tensor
    several_chi2: Tensor
    place_m: Tensor
    place_ci95_m: Tensor
    region_m: Tensor
    force_n: Tensor
    contact_covariance: Tensor
    magnitude_ci95_n: Tensor
    moment_n_m: Tensor
    moment_std_n_m: Tensor
    fault_n: Tensor
    innovation_n: Tensor
    information_n2: Tensor
    by_parameter: Tensor
    by_torque: Tensor
    at_joint_m: Tensor
    by_place: Tensor
    pose_rad: Tensor


class ArmEstimator(nn.Module):
    """`EstimatorOutput` of readings (B, M) at commands (B, 2N), mean (P,) and covariance (P, P).

    Args:
        mechanism: the arm as its file describes it, with effects on its body.
        held_by: the arm by which its actuators are commanded: as drawn.
        parameters: its uncertain parameters.
        reading_variance_n2: of one reading: noise and step of the sensor, N².
        friction: where the cables rub.
        touched: where the segments can be touched.
        pose_steps: Gauss-Newton steps from the command to the pose.
        unexplained_n2: (M, M) covariance of readings by what is not known of the arm, N².
    """

    def __init__(
        self,
        mechanism: Mechanism,
        held_by: Mechanism,
        parameters: ArmParameters,
        reading_variance_n2: float,
        friction: CableFriction,
        touched: TouchedPlaces,
        pose_steps: int = POSE_STEPS,
        unexplained_n2: Array | None = None,
    ) -> None:
        super().__init__()
        self.measurement = MeasurementModel(
            mechanism,
            held_by,
            parameters,
            reading_variance_n2,
            friction,
            pose_steps,
            unexplained_n2,
        )
        length_m = mechanism.segment_length_m
        joint_m = np.concatenate([[0.0], np.cumsum(length_m)[:-1]])
        self.statement = ContactStatement(touched, length_m, joint_m, torque_scale_of(length_m))

    def forward(
        self,
        reading_n: Tensor,
        command_rad: Tensor,
        mean: Tensor,
        covariance: Tensor,
        unrest_n2_m2: Tensor,
    ) -> EstimatorOutput:
        """The posterior; `unrest_n2_m2` (2N, 2N) is the covariance of torques by motion."""
        seen = self.measurement(reading_n, command_rad, mean, covariance, unrest_n2_m2)
        statement = self.statement(evidence_of(seen))
        at_joint, by_place = seen.levers.split(3, dim=2)
        return EstimatorOutput(
            **statement._asdict(),
            innovation_n=seen.innovation_n[:, 0],
            information_n2=seen.information_n2,
            by_parameter=seen.by_parameter,
            by_torque=seen.by_torque,
            at_joint_m=at_joint,
            by_place=by_place,
            pose_rad=seen.pose_rad[:, 0],
        )
