"""Any force and moment on one segment, as a linear fit on every segment.

The five unknowns are a force f at the joint centre and the moments s f_y and s f_z, where s is the
distance of a contact along the axis. Without the condition that both have the same s they are
linear: what several contacts on one segment, or a couple, make. One contact is a special case, so
the fit also says where on the segment it is worth to look for it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_training.law.evidence import Evidence
from cablesense_training.law.geometry import Matrix, constant
from cablesense_training.law.measurement import inverse

FORCE_STD_N = 100.0
"""Prior deviation of each component of the forces that several contacts have in sum."""

_ZERO_SQUARE = 1e-18
"""Square that counts as zero, in N², (N·m)² or their product: it is divided by."""


class SegmentWrench(NamedTuple):
    """The fits on N segments, for B samples; M channels.

    Forces are in units of `FORCE_STD_N`, moments in those of that force in mid-segment.

    Attributes:
        unit_torques: (B, N, 5, 2N) of the unknowns.
        precision: (B, N, 5, 5) and
        covariance: (B, N, 5, 5) of the unknowns.
        mean: (B, N, 5, 1).
        chi2_gain: (B, N) by how much they lower χ².
        table: (B, N, 7, 8) L P L' and L P τ, where the rows of L are the torques by forces at the
            joint centre, their derivatives by the place, and the torques by a torsion.
    """

    unit_torques: Tensor
    precision: Tensor
    covariance: Tensor
    mean: Tensor
    chi2_gain: Tensor
    table: Tensor


class ContactLine(NamedTuple):
    """The single contact that a wrench is like, (B, N, 1, 1).

    Attributes:
        place_m, std_m: where its line of action crosses the axis; the deviation is large where
            the force is not known.
    """

    place_m: Tensor
    std_m: Tensor


class Strength(NamedTuple):
    """One over the square of the lateral force of a contact at s: first + s² second.

    That is 1/f² where f is known, and s²/m² of the moment elsewhere.

    Attributes:
        per_force2: (B, N, 1, 1) 1/N².
        per_moment2: (B, N, 1, 1) 1/(N·m)².
    """

    per_force2: Tensor
    per_moment2: Tensor


class WrenchFit(nn.Module):
    """`SegmentWrench` of measurements.

    Args:
        length_m: (N,) of the segments.
        felt_across: (N, 2, 2) or (2, 2) projections of forces across the segments, along y and z,
            to what makes a torque in some pose.
    """

    def __init__(self, length_m: Matrix, felt_across: Matrix) -> None:
        super().__init__()
        self.middle_m = 0.5 * float(length_m.mean())
        self.length_m = float(length_m.max())
        scale = np.array([FORCE_STD_N] * 3 + [FORCE_STD_N * self.middle_m] * 2)
        self.rows = constant(np.array([0, 1, 2, 4, 5]))
        self.columns = constant(np.array([0, 1, 2, 4, 5, 7]))
        self.scale = constant(scale[:, None])
        self.scales = constant(scale[:, None] * np.append(scale, 1.0))
        self.identity = constant(np.eye(5))
        self.axial_n2 = constant(np.diag([FORCE_STD_N**2, 0.0, 0.0, 0.0, 0.0]))
        across = np.zeros((5, 5))
        for product in ((3, 2), (2, 3)):
            across[product] = 1.0
        for product in ((4, 1), (1, 4)):
            across[product] = -1.0
        self.across = constant(across)
        lateral = np.zeros((*felt_across.shape[:-2], 5, 5))
        lateral[..., 1:3, 1:3] = felt_across
        self.lateral = constant(lateral)

    def forward(self, seen: Evidence) -> SegmentWrench:
        """The fits."""
        levers = torch.cat([seen.levers, seen.by_torsion], dim=2)
        information = levers @ seen.torque_precision[:, None] @ levers.transpose(2, 3)
        pull = levers @ seen.torque_pull[:, None].transpose(2, 3)
        table = torch.cat([information, pull], dim=3)
        information, pull = self._of_unknowns(table)
        precision = information + self.identity
        covariance = inverse(precision)
        mean = covariance @ pull
        return SegmentWrench(
            unit_torques=seen.levers.index_select(2, self.rows) * self.scale,
            precision=precision,
            covariance=covariance,
            mean=mean,
            chi2_gain=(mean * pull).sum((2, 3)),
            table=table,
        )

    def refined_line(self, table: Tensor, axial_precision: Tensor) -> ContactLine:
        """The contact by a table (B, N, 6, 8), with a bound to its axial force."""
        information, pull = self._of_unknowns(table)
        precision = information + self.identity + self.axial_n2 * axial_precision
        covariance = inverse(precision)
        return self.line(covariance, covariance @ pull)

    def line(self, covariance: Tensor, mean: Tensor) -> ContactLine:
        """The contact that a wrench is like."""
        # of a contact m_y f_z = m_z f_y: a step towards that, and what it leaves of the covariance
        across = self.across @ mean
        towards = covariance @ across
        share = towards / (across * towards).sum(2, keepdim=True).clamp(min=_ZERO_SQUARE)
        mean = mean - share * (0.5 * (across * mean).sum(2, keepdim=True))
        covariance = covariance - share * towards.transpose(2, 3)
        _, force, moment = mean.split((1, 2, 2), dim=2)
        squared = (force * force).sum(2, keepdim=True).clamp(min=_ZERO_SQUARE)
        # s = m · f / |f|², its derivative by f and m, and their covariance
        place = (moment * force).sum(2, keepdim=True) / squared
        slope = torch.cat([0.0 * place, moment - 2.0 * place * force, force], dim=2) / squared
        variance = (covariance @ slope * slope).sum(2, keepdim=True).clamp(min=0.0)
        # where the force is not larger than its deviation that says nothing, and s is anywhere
        doubt = (covariance * self.lateral).sum((2, 3), keepdim=True)
        return ContactLine(
            place_m=self.middle_m * place,
            std_m=self.middle_m * torch.sqrt(variance) + self.length_m * (doubt / squared),
        )

    def strength(self, wrench: SegmentWrench) -> Strength:
        """How large the lateral force of a contact is that is like this wrench."""
        _, force, moment = wrench.mean.split((1, 2, 2), dim=2)
        doubt = (wrench.covariance * self.lateral).sum((2, 3), keepdim=True)
        known = FORCE_STD_N**-2 / ((force * force).sum(2, keepdim=True) + doubt)
        moment_squared = (moment * moment).sum(2, keepdim=True).clamp(min=_ZERO_SQUARE)
        return Strength(known, self.middle_m**-2 * known * (doubt / moment_squared))

    def _of_unknowns(self, table: Tensor) -> tuple[Tensor, Tensor]:
        """Information (B, N, 5, 5) and pull (B, N, 5, 1) of the unknowns."""
        chosen = table.index_select(2, self.rows).index_select(3, self.columns) * self.scales
        information, pull = chosen.split((5, 1), dim=3)
        return information, pull
