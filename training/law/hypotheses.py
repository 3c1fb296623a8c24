"""The rival hypotheses about a reading, each with its evidence under the same covariance S.

Nothing touches the arm; one contact on segment n; whatever acts on one segment, a couple or
several contacts; several contacts on the whole arm; and each of the first three beside one channel
that reads a wrong number, or two channels exchanged. Evidences are logarithms against "nothing
touches". All but the contact itself are linear with normal priors, so theirs has a closed form:

    log E = x' (H + Λ)⁻¹ x / 2 - log det(I + Λ⁻¹ H) / 2,

with H and x the information and pull of the unknowns and Λ the inverse of their prior covariance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_training.law.evidence import Evidence
from cablesense_training.law.geometry import Matrix, constant
from cablesense_training.law.measurement import inverse
from cablesense_training.law.wrench import FORCE_STD_N, SegmentWrench

FAULT_STD_N = 20.0
"""Prior deviation of what a faulty channel adds to its reading."""


class Hypotheses(NamedTuple):
    """Log evidence and χ² of the hypotheses on B samples; M channels, N segments.

    Attributes:
        free_chi2: (B,) of the untouched arm; M degrees of freedom.
        faulty_free: (B, M) nothing touches and channel j is wrong.
        exchanged_free: (B, M, M) nothing touches and channels i and j are exchanged.
        segment: (B, N) any force and moment on segment n.
        faulty_segment: (B, M, N) the same, and channel j is wrong.
        several: (B,) any torques at the joints.
        several_gain: (B,) by how much these lower χ².
        faulty_free_n: (B, M) what channel j then reads too much.
    """

    free_chi2: Tensor
    faulty_free: Tensor
    exchanged_free: Tensor
    segment: Tensor
    faulty_segment: Tensor
    several: Tensor
    several_gain: Tensor
    faulty_free_n: Tensor


class RivalHypotheses(nn.Module):
    """`Hypotheses` of evidence.

    Args:
        torque_scale: (T,) prior deviation of the torques of several contacts, each by itself.
    """

    def __init__(self, torque_scale: Matrix) -> None:
        super().__init__()
        scale = torque_scale
        joints = len(scale)
        self.torque_scale = constant(scale[:, None])
        self.torque_scales = constant(scale[:, None] * scale)
        self.torque_identity = constant(np.eye(joints))
        # determinants of all hypotheses at once, of a size that can be halved
        size = 2 ** int(np.ceil(np.log2(max(joints, 5))))
        self.wrench_place = constant(np.eye(5, size))
        self.wrench_rest = constant(np.diag(np.arange(size) >= 5).astype(float))
        self.torque_place = constant(np.eye(joints, size))
        self.torque_rest = constant(np.diag(np.arange(size) >= joints).astype(float))

    def forward(self, seen: Evidence, wrench: SegmentWrench) -> Hypotheses:
        """The evidence of each."""
        information = seen.channel_information
        weighted = seen.channel_pull
        channel_information = torch.diagonal(information, dim1=1, dim2=2)[:, None]
        faulty_free, faulty_n = _fault(weighted, channel_information)

        # exchanged: the innovation without the difference of the two readings
        apart = seen.reading_n - seen.reading_n.transpose(1, 2)
        pulls = weighted - weighted.transpose(1, 2)
        pair_information = (
            channel_information + channel_information.transpose(1, 2) - 2.0 * information
        )
        exchanged_free = apart * (pulls - 0.5 * apart * pair_information)

        scaled = seen.torque_precision * self.torque_scales + self.torque_identity
        pull = seen.torque_pull.transpose(1, 2) * self.torque_scale
        several_gain = (inverse(scaled) @ pull * pull).sum((1, 2))
        several = self._padded(scaled, self.torque_place, self.torque_rest)
        segments = self._padded(wrench.precision, self.wrench_place, self.wrench_rest)
        determinants = _log_determinants(torch.cat([segments, several[:, None]], dim=1))
        of_segments, of_several = determinants.split((segments.shape[1], 1), dim=1)
        segment = 0.5 * (wrench.chi2_gain - of_segments)

        # beside any wrench on a segment, a wrong channel: S⁻¹ is then less by what that explains
        seen_in = wrench.unit_torques @ seen.informed[:, None].transpose(2, 3)
        explained = wrench.covariance @ seen_in
        unexplained = channel_information - (explained * seen_in).sum(2)
        pulled = weighted - (wrench.mean.transpose(2, 3) @ seen_in)[:, :, 0]
        faulty_segment, _ = _fault(pulled, unexplained)
        return Hypotheses(
            free_chi2=seen.untouched_chi2,
            faulty_free=faulty_free[:, 0],
            exchanged_free=exchanged_free,
            segment=segment,
            faulty_segment=(faulty_segment + segment[:, :, None]).transpose(1, 2),
            several=0.5 * (several_gain - of_several[:, 0]),
            several_gain=several_gain,
            faulty_free_n=faulty_n[:, 0],
        )

    def _padded(self, matrix: Tensor, place: Tensor, rest: Tensor) -> Tensor:
        """A larger matrix with the same determinant."""
        return place.T @ matrix @ place + rest


def torque_scale_of(length_m: Matrix) -> Matrix:
    """(2N,) of an arm with segments of lengths (N,): by forces in the middle of all segments."""
    count = len(length_m)
    levers_m = np.arange(count, 0, -1) - 0.5
    torque = FORCE_STD_N * float(length_m.mean()) * np.sqrt(np.cumsum(levers_m[::-1] ** 2)[::-1])
    return np.repeat(torque, 2)


def _fault(pull: Tensor, own: Tensor) -> tuple[Tensor, Tensor]:
    """Log evidence of each channel's fault alone, and the fault itself, N."""
    known = own + FAULT_STD_N**-2
    fault_n = pull / known
    return 0.5 * (fault_n * pull - torch.log(known * FAULT_STD_N**2)), fault_n


def _log_determinants(matrix: Tensor) -> Tensor:
    """(B, H) of positive matrices (B, H, 2^k, 2^k), by Schur complements of their halves."""
    hypotheses = matrix.shape[1]
    size = matrix.shape[2]
    while size > 2:
        size = size // 2
        upper, lower = matrix.split(size, dim=2)
        first, across = upper.split(size, dim=3)
        across_t, last = lower.split(size, dim=3)
        matrix = torch.cat([first, last - across_t @ inverse(first) @ across], dim=1)
    a, b, c, d = matrix.flatten(2).split(1, dim=2)
    logarithms = torch.log(a * d - b * c)
    return logarithms.reshape(-1, logarithms.shape[1] // hypotheses, hypotheses).sum(1)
