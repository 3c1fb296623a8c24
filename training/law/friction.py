"""What friction makes of the tension of a cable, from its actuator to its end."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_sim.mechanism import Mechanism
from cablesense_sim.uncertain_arm import CableFriction
from cablesense_training.law.geometry import Matrix, Spans, constant
from cablesense_training.law.parameters import Parameters


class CarriedTensions(NamedTuple):
    """What friction makes of the tensions at the actuators.

    Attributes:
        ratio: (B, N, M) ρ of the tension across a joint.
        compliance_m_n: (B, 1, M) κ, stretch of a cable by that tension.
        wrap_rad: (B, N + 1, M) at the guides.
        by_exponent: (B, N + 1, M) derivative of κ / κ_0 by the exponents ε Φ.
        by_run: (B, 1, M) the same by the logarithm of `run_compliance`.
    """

    ratio: Tensor
    compliance_m_n: Tensor
    wrap_rad: Tensor
    by_exponent: Tensor
    by_run: Tensor


class GuideFriction(nn.Module):
    """`CarriedTensions` of cables by the friction that they carry.

    A cable's guides are at the actuator, and in the plates 0 to N - 1.

    Args:
        mechanism: the arm as its file describes it.
        friction: where the cables rub.
    """

    def __init__(self, mechanism: Mechanism, friction: CableFriction) -> None:
        super().__init__()
        count = mechanism.segment_count
        wrap_rad = np.full((count + 1, mechanism.cable_count), friction.guide_wrap_rad)
        wrap_rad[0] = friction.pulley_wrap_rad
        wrap_rad[1] = 0.0
        wrap_rad[1:] *= mechanism.passes_joint.T
        self.wrap_rad = constant(wrap_rad)
        self.plate_of_guide = constant(np.eye(count + 1, k=-1))
        # of the compliance behind the pulley: the run up to the base, and from each joint on
        self.behind_pulley = constant(_compliance_shares(mechanism))
        pieces_behind = np.concatenate([np.eye(1, count + 1), guides_up_to_joints(count)])
        self.pieces_behind = constant(pieces_behind)

    def forward(self, spans: Spans, given: Parameters) -> CarriedTensions:
        """What friction makes of tensions.

        With the share r of a cable's compliance before the pulley, and the shares c of the pieces
        behind it, a tension T at the actuator stretches it by κ T, κ = κ_0 (r + (1 - r) Σ c ρ).
        """
        wrap_rad = self.plate_of_guide @ spans.bend_rad + self.wrap_rad
        carried = torch.exp(self.pieces_behind @ (given.carried_friction * wrap_rad))
        stretched = self.behind_pulley * carried
        behind = stretched.sum(1, keepdim=True)
        run = given.run_share
        return CarriedTensions(
            ratio=carried[:, 1:],
            compliance_m_n=given.compliance_m_n * (run + (1.0 - run) * behind),
            wrap_rad=wrap_rad,
            by_exponent=self.pieces_behind.T @ ((1.0 - run) * stretched),
            by_run=run * (1.0 - run) * (1.0 - behind),
        )


def guides_up_to_joints(count: int) -> Matrix:
    """(N, N + 1) which guides stand between the actuator and the span across each of N joints."""
    return np.tril(np.ones((count, count + 1)), 1)


def _compliance_shares(mechanism: Mechanism) -> Matrix:
    """(N + 1, M) shares of the compliance behind the pulley: the run, and from each joint on."""
    pieces = mechanism.piece_length_m
    count = mechanism.segment_count
    behind = np.zeros((count + 1, mechanism.cable_count))
    behind[0] = pieces[:, 0]
    for n in range(count):
        behind[n + 1] = pieces[:, 1 + 2 * n]
        if n + 1 < count:
            behind[n + 1] += pieces[:, 2 + 2 * n]
    return behind / behind.sum(0)
