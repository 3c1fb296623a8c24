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

import torch
from torch import Tensor, nn

from cablesense_training.law.geometry import constant
from cablesense_training.law.measurement import Measurement

import numpy as np

FAULT_STD_N = 20.0
"""Prior deviation of what a faulty channel adds to its reading."""

FORCE_STD_N = 30.0
"""Prior deviation of each component of the forces that several contacts have in sum."""


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
    """`Hypotheses` of measurements, for an arm with segments of lengths (N,) in m."""

    def __init__(self, length_m: np.ndarray) -> None:
        super().__init__()
        middle_m = 0.5 * float(length_m.mean())
        scale = [FORCE_STD_N] * 3 + [FORCE_STD_N * middle_m] * 2
        self.wrench_scale = constant(np.array(scale)[:, None])
        count = len(length_m)
        # torques by forces in the middle of all segments, as independent at each joint
        levers_m = np.arange(count, 0, -1) - 0.5
        torque = (
            FORCE_STD_N * float(length_m.mean()) * np.sqrt(np.cumsum(levers_m[::-1] ** 2)[::-1])
        )
        self.torque_scale = constant(np.repeat(torque, 2))
        self.wrench_identity = constant(np.eye(5))
        self.torque_identity = constant(np.eye(2 * count))

    def forward(self, seen: Measurement, reading_n: Tensor) -> Hypotheses:
        """The evidence of each, `reading_n` (B, M) being what was measured."""
        information = seen.information_n2
        weighted = (information @ seen.innovation_n[..., None])[..., 0]
        free_chi2 = (weighted * seen.innovation_n).sum(1)
        own = torch.diagonal(information, dim1=1, dim2=2)

        known = own + FAULT_STD_N**-2
        occam = 0.5 * torch.log(known * FAULT_STD_N**2)
        faulty_free = 0.5 * weighted**2 / known - occam

        # exchanged: the innovation without the difference of the two readings
        apart = reading_n[:, :, None] - reading_n[:, None]
        pulls = weighted[:, :, None] - weighted[:, None]
        both = own[:, :, None] + own[:, None] - 2.0 * information
        exchanged_free = apart * pulls - 0.5 * apart**2 * both

        # any wrench on one segment, alone and beside a wrong channel j: the information of the
        # torques is then all but what goes in the channel's direction
        weights = information @ seen.by_torque
        lost = weights[..., None] * (weights / known[..., None])[:, :, None]
        lost_pull = weights * (weighted / known)[..., None]
        precision = torch.cat(
            [seen.torque_precision[:, None], seen.torque_precision[:, None] - lost], 1
        )
        pull = torch.cat([seen.torque_pull[:, None], seen.torque_pull[:, None] - lost_pull], 1)
        levers = torch.cat([seen.at_joint_m, seen.by_place[:, :, 1:]], dim=2) * self.wrench_scale
        levers = levers[:, None]
        wrench, _ = _evidence(
            levers @ precision[:, :, None] @ levers.transpose(3, 4),
            levers @ pull[:, :, None, :, None],
            self.wrench_identity,
        )
        segment = wrench[:, 0]
        faulty_segment = wrench[:, 1:] + faulty_free[..., None]

        scale = self.torque_scale
        several, gain = _evidence(
            scale[:, None] * seen.torque_precision * scale,
            (scale * seen.torque_pull)[..., None],
            self.torque_identity,
        )
        return Hypotheses(
            free_chi2,
            faulty_free,
            exchanged_free,
            segment,
            faulty_segment,
            several,
            gain,
            weighted / known,
        )


def _evidence(information: Tensor, pull: Tensor, identity: Tensor) -> tuple[Tensor, Tensor]:
    """Log evidence (...) of unknowns with standard normal priors, and by how much they lower χ².

    `information` is (..., k, k) and `pull` (..., k, 1). Gaussian elimination gives the determinant
    and the quadratic form at once: its rows begin with the pivots.
    """
    matrix = torch.cat([information + identity, pull], dim=-1)
    unknowns = pull.shape[-2]
    ends = []
    for _ in range(unknowns):
        row = matrix[..., :1, :]
        pivot = row[..., :1]
        ends.append(torch.cat([pivot, row[..., -1:]], dim=-1))
        matrix = matrix[..., 1:, 1:] - matrix[..., 1:, :1] * (row / pivot)[..., 1:]
    pivots, pulls = torch.cat(ends, dim=-2).split(1, dim=-1)
    gain = (pulls * pulls / pivots).sum((-2, -1))
    return 0.5 * (gain - torch.log(pivots).sum((-2, -1))), gain
