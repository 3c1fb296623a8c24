"""The whole estimator as one module: a reading, a command and a calibration in, a posterior out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_sim.mechanism import Mechanism
from cablesense_sim.tolerances import ArmParameters
from cablesense_training.law.geometry import constant, error_function
from cablesense_training.law.hypotheses import RivalHypotheses
from cablesense_training.law.measurement import FrictionWraps, MeasurementModel
from cablesense_training.law.posterior import LARGEST_N, ContactPosterior, PosteriorOfContact

_POINTS = 61
"""Points at which a distribution is taken for the ends of its interval."""
_WIDTH = 5.0
"""Standard deviations that they cover to each side."""
_LOW = 0.025
_HIGH = 0.975


class EstimatorOutput(NamedTuple):
    """What a reading says, for B samples of an arm with N segments, M cables and P parameters.

    Log evidences are against "nothing touches". Forces are along the axes that their segment has
    at the command; those of one contact are of the likeliest segment.

    Attributes:
        contact_evidence: (B, N) of one contact on this segment.
        segment_evidence: (B, N) of any force and moment on this segment.
        several_evidence: (B,) of several contacts on the whole arm.
        faulty_evidence: (B, M) nothing touches, and this channel is wrong.
        faulty_segment_evidence: (B, M, N) any force on this segment, and this channel is wrong.
        exchanged_evidence: (B, M, M) nothing touches, and two channels are exchanged.
        free_chi2, contact_chi2, several_chi2: (B,) that nothing, one contact, and several leave.
        place_m: (B,) mean distance from the joint centre.
        place_ci95_m: (B, 2) interval of it.
        region_m: (B, 2) interval of the place over all segments, from the first joint centre along
            the straight arm.
        force_n: (B, 3) mean.
        contact_covariance: (B, 4, 4) of place, m, and force, N.
        magnitude_ci95_n: (B, 2) interval of the lateral force.
        moment_n_m, moment_std_n_m: (B, 2) about the joint centre, around y and z.
        fault_n: (B, M) what each channel reads too much if nothing touches and it is wrong.
        innovation_n: (B, M) reading minus that of the untouched arm.
        information_n2: (B, M, M) inverse covariance of innovations.
        by_parameter: (B, M, P) derivative of readings by the parameters.
        by_torque: (B, M, 2N) derivative of readings by contact torques.
        at_joint_m, by_place: (B, N, 3, 2N) torques of unit forces at the joint centres, and their
            derivative by the distance from these.
        pose_rad: (B, 2N) joint angles.
    """

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
        wraps: of the cables with the arm straight.
        reach_m: (N, 2) places on each segment where it can be touched.
        radius_m: (N,) of the touched surface.
        friction: coefficient of the touched surface; zero where contacts act on the axis.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        held_by: Mechanism,
        parameters: ArmParameters,
        reading_variance_n2: float,
        wraps: FrictionWraps,
        reach_m: np.ndarray,
        radius_m: np.ndarray,
        friction: float,
    ) -> None:
        super().__init__()
        self.measurement = MeasurementModel(
            mechanism, held_by, parameters, reading_variance_n2, wraps
        )
        self.contact = PosteriorOfContact(reach_m, radius_m, friction)
        self.rivals = RivalHypotheses(mechanism.segment_length_m)
        self.points = constant(np.linspace(0.0, 1.0, _POINTS))
        self.ends = constant(np.array([[_LOW], [_HIGH]]))
        self.low_m = constant(reach_m[:, :1])
        self.high_m = constant(reach_m[:, 1:])
        length = mechanism.segment_length_m
        self.joint_m = constant(np.concatenate([[0.0], np.cumsum(length)[:-1]]))
        self.numbers = constant(np.arange(mechanism.segment_count))
        self.earlier = constant(np.tril(np.ones((len(length), len(length))), -1).T)

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
        one = self.contact(
            seen.torque_precision,
            seen.torque_pull,
            seen.at_joint_m,
            seen.by_place,
            seen.by_torsion,
        )
        rival = self.rivals(seen, reading_n)
        best = one.log_evidence.argmax(1, keepdim=True)
        chosen = (best == self.numbers).to(reading_n.dtype)
        place_ci, region = self._places(one, chosen)

        def of_best(values: Tensor) -> Tensor:
            shaped = chosen.reshape(-1, chosen.shape[1], *([1] * (values.dim() - 2)))
            return (values * shaped).sum(1)

        means = of_best(one.means)
        spread = of_best(one.covariance)
        gain = of_best(one.chi2_gain)
        return EstimatorOutput(
            contact_evidence=one.log_evidence,
            segment_evidence=rival.segment,
            several_evidence=rival.several,
            faulty_evidence=rival.faulty_free,
            faulty_segment_evidence=rival.faulty_segment,
            exchanged_evidence=rival.exchanged_free,
            free_chi2=rival.free_chi2,
            contact_chi2=rival.free_chi2 - gain,
            several_chi2=rival.free_chi2 - rival.several_gain,
            place_m=means[:, 0],
            place_ci95_m=place_ci,
            region_m=region,
            force_n=means[:, 1:],
            contact_covariance=spread,
            magnitude_ci95_n=self._magnitudes(
                of_best(one.weight), of_best(one.lateral_n), of_best(one.lateral_std_n)
            ),
            moment_n_m=of_best(one.moment_n_m),
            moment_std_n_m=of_best(one.moment_std_n_m),
            fault_n=rival.faulty_free_n,
            innovation_n=seen.innovation_n,
            information_n2=seen.information_n2,
            by_parameter=seen.by_parameter,
            by_torque=seen.by_torque,
            at_joint_m=seen.at_joint_m,
            by_place=seen.by_place,
            pose_rad=seen.pose_rad,
        )

    def _magnitudes(self, weight: Tensor, lateral_n: Tensor, std_n: Tensor) -> Tensor:
        """The interval (B, 2) of a mixture (B, K) of normal magnitudes, up to the largest."""
        mean = (weight * lateral_n).sum(1, keepdim=True)
        variance = (weight * (std_n**2 + (lateral_n - mean) ** 2)).sum(1, keepdim=True)
        width = _WIDTH * torch.sqrt(variance)
        low = (mean - width).clamp(min=0.0)
        high = mean + width
        points = low + (high - low) * self.points
        off = (points[:, :, None] - lateral_n[:, None]) * torch.rsqrt(2.0 * std_n**2)[:, None]
        cdf = 0.5 * (weight[:, None] * (1.0 + error_function(off))).sum(2)
        # forces beyond the largest that is expected count only where all are
        most = cdf[:, -1:]
        inside = (cdf * (points <= LARGEST_N)).amax(1, keepdim=True)
        most = torch.where(inside > _LOW, inside, most)
        return _quantiles(points, cdf / most, self.ends)

    def _places(self, one: ContactPosterior, chosen: Tensor) -> tuple[Tensor, Tensor]:
        """The intervals (B, 2) of the place on the chosen segment, and along the arm."""
        mean = one.means[:, :, :1]
        std = torch.sqrt(one.covariance[:, :, :1, 0])
        low = torch.maximum(mean - _WIDTH * std, self.low_m)
        high = torch.minimum(mean + _WIDTH * std, self.high_m)
        points = low + (high - low) * self.points
        off = points[..., None] - one.place_m[:, :, None]
        scaled = off * torch.rsqrt(2.0 * one.place_std_m**2)[:, :, None]
        cdf = 0.5 * (one.weight[:, :, None] * (1.0 + error_function(scaled))).sum(3)
        # what lies beyond the ends of the segment is taken to be on it
        cdf = (cdf - cdf[:, :, :1]) / (cdf[:, :, -1:] - cdf[:, :, :1] + 1e-12)
        own_points = (points * chosen[..., None]).sum(1)
        own_cdf = (cdf * chosen[..., None]).sum(1)
        own = _quantiles(own_points, own_cdf, self.ends)
        probability = torch.softmax(one.log_evidence, dim=1)
        before = probability @ self.earlier
        along = (points + self.joint_m[:, None]).flatten(1)
        all_cdf = (before[..., None] + probability[..., None] * cdf).flatten(1)
        return own, _quantiles(along, all_cdf, self.ends)


def _quantiles(points: Tensor, cdf: Tensor, shares: Tensor) -> Tensor:
    """(B, S) where a distribution function (B, Q) at ascending points reaches shares (S, 1)."""
    above = (cdf[:, None] < shares).to(torch.int64).sum(2).clamp(1, points.shape[1] - 1)
    below = above - 1
    low = torch.gather(points, 1, below)
    high = torch.gather(points, 1, above)
    low_cdf = torch.gather(cdf, 1, below)
    high_cdf = torch.gather(cdf, 1, above)
    part = (shares[:, 0] - low_cdf) / (high_cdf - low_cdf + 1e-12)
    return low + (high - low) * part.clamp(0.0, 1.0)
