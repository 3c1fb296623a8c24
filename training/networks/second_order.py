"""The closed form for a stiff arm, to second order in its give: a thousand answers a second.

On a stiff arm the joints deflect by a few milliradians. `ClosedForm` computes everything anew at
the true pose; here it is expanded about the commanded one. With the set W of taut cables, under a
contact f on segment s,

    dq(f) = dq_W + E_s f,    T(f) = W (T0 + k J dq),
    L_s' f = J' T - tau_weight + r_s(f),    r_s(f) = (dJ dq)' T - (dtau_weight) dq - (dL_s dq)' f,

all at the command, where r_s collects what the give changes: cable levers, weight, contact levers.
It is quadratic in f, so one substitution of the first-order solution f0 solves for f to second
order:

    f = f0 + K_s r_s(f0),    f0 = K_s (J' T - tau_weight),    K_s = C_s L_s P.

Everything but the last line depends on the command and on which cables are taut, and changes as
seldom as they do.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from cablesense_training.networks.closed_form import (
    NUDGE_N,
    SLACK_WEIGHT,
    Candidates,
    ClosedForm,
    Weighing,
    gram_inverse,
    inverse,
    own_blocks,
)
from cablesense_training.networks.compact import CompactPose

_STEP_RAD = 1e-4
"""Step of the central differences that give derivatives by the pose; their error is a part in
1e8."""


class _Expansion(NamedTuple):
    """Kinematics at the command and their derivatives by joint angle k.

    Attributes:
        jacobian_t: (B, 2N, M); lever: (B, 2N, 2N) by force component; weight: (B, 2N, 1).
        jacobian_by: (B, k, 2N · M); lever_by: (B, k, 2N · 2N); weight_by: (B, k, 2N).
    """

    jacobian_t: Tensor
    lever: Tensor
    weight: Tensor
    jacobian_by: Tensor
    lever_by: Tensor
    weight_by: Tensor


class SecondOrderClosedForm(nn.Module):
    """Candidates from tension differences (B, M) and joint commands (B, 2N), in float64.

    Args:
        exact: the closed form of the arm; stiff, see `pose_corrections_for`.
    """

    offsets: Tensor
    own: Tensor
    left_factor: Tensor
    right_factor: Tensor

    def __init__(self, exact: ClosedForm) -> None:
        super().__init__()
        self.exact = exact
        self.reading_variance_n2 = exact.reading_variance_n2
        segments = exact.kinematics.segment_count
        forward = _STEP_RAD * torch.eye(2 * segments, dtype=torch.float64)
        self.register_buffer("offsets", torch.cat([forward, -forward])[:, :, None])
        self.register_buffer("own", torch.eye(segments, dtype=torch.float64)[:, None, :, None])
        first = 2 * torch.arange(segments)[:, None]
        self.register_buffer("left_factor", (first + torch.tensor([0, 0, 1])).ravel())
        self.register_buffer("right_factor", (first + torch.tensor([0, 1, 1])).ravel())

    def weigh(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor, weighing: Weighing
    ) -> Candidates:
        """The candidates, and the evidence for them.

        Both are polynomials of f0, linear in its components and their products within a segment:
        one product with a matrix that is held while command and taut cables stay the same. The
        evidence takes f0 for f, which is a part in a thousand.
        """
        n = self.exact.kinematics.segment_count
        angles, commanded, normal_cross = self.exact.at_command(joint_command_rad)
        unloaded_tension, _ = self.exact.unloaded(angles, commanded, normal_cross)
        about = self._expand(angles, commanded, normal_cross)
        slack_at = self.exact.slack_below_n - unloaded_tension[..., 0]

        taut = (tension_difference_n > slack_at).to(tension_difference_n.dtype)
        weight = taut[:, :, None] * (1.0 - SLACK_WEIGHT) + SLACK_WEIGHT
        precision = gram_inverse(about.jacobian_t, weight) * (1.0 / self.reading_variance_n2)
        weighted = about.lever @ precision
        information = own_blocks(weighted @ about.lever.transpose(1, 2), n)
        covariance = inverse(information)
        gain = covariance @ weighted.reshape(-1, n, 2, 2 * n)
        constant, bilinear, linear = self._give(about, weight)
        still, _, _ = self._give(about, torch.ones_like(weight))
        pulled = about.jacobian_t * taut[:, None]
        balance = (pulled - about.jacobian_t) @ unloaded_tension + constant - still
        flat_gain = gain.reshape(-1, 2 * n, 2 * n)
        first = (flat_gain @ pulled).transpose(1, 2)
        offset = (flat_gain @ balance).transpose(1, 2)
        trusted, prior = weighing(information, covariance)
        polynomial, remainder = self._polynomial(gain, bilinear, linear, trusted, prior)

        guess = tension_difference_n[:, None] @ first + offset
        products = guess.index_select(2, self.left_factor) * guess.index_select(
            2, self.right_factor
        )
        answer = torch.cat([guess, products], dim=2) @ polynomial + remainder
        force, evidence = answer.split([2 * n, n], dim=2)
        return Candidates(force.reshape(-1, n, 2), covariance, taut, evidence)

    def _polynomial(
        self, gain: Tensor, bilinear: Tensor, linear: Tensor, trusted: Tensor, prior: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Coefficients (B, 5N, 3N) of (f0, products of f0) for (f, evidence), and constants."""
        n = self.exact.kinematics.segment_count
        straight = (gain @ linear).transpose(2, 3) + torch.eye(2, dtype=gain.dtype)
        bent = _of_products(gain[:, :, None] @ bilinear)
        to_force = torch.cat([self._apart(straight), self._apart(bent)], dim=1)
        evidence = self._apart(_of_products(trusted[:, :, :, None]))
        to_evidence = torch.cat([0.0 * self._apart(straight)[:, :, :n], evidence], dim=1)
        nudge = 0.0 * prior.repeat(1, 2) + NUDGE_N
        remainder = torch.cat([nudge, prior], dim=1)[:, None]
        return torch.cat([to_force, to_evidence], dim=2), remainder

    def _apart(self, blocks: Tensor) -> Tensor:
        """Block diagonal matrices (B, N·r, N·c) of blocks (B, N, r, c)."""
        n, rows, columns = self.exact.kinematics.segment_count, *blocks.shape[2:]
        spread = blocks[:, :, :, None] * self.own
        return spread.reshape(-1, n * rows, n * columns)

    def _expand(self, angles: Tensor, commanded: CompactPose, normal_cross: Tensor) -> _Expansion:
        """Kinematics at the command, and central differences of them by every joint angle."""
        n, m = self.exact.kinematics.segment_count, self.exact.kinematics.cable_count
        joints = 2 * n
        around = self.exact.kinematics((angles[:, None] + self.offsets).reshape(-1, joints, 1))
        spread = (normal_cross[:, None] + 0.0 * self.offsets[:, :1]).reshape(-1, 6 * n + 6, 3)
        lever, weight = self.exact.kinematics.levers(commanded, normal_cross)
        levers, weights = self.exact.kinematics.levers(around, spread)

        def by_angle(values: Tensor, size: int) -> Tensor:
            sides = values.reshape(-1, 2, joints, size)
            return (sides[:, 0] - sides[:, 1]) * (0.5 / _STEP_RAD)

        return _Expansion(
            jacobian_t=commanded.jacobian_t_m,
            lever=lever.reshape(-1, joints, joints),
            weight=weight,
            jacobian_by=by_angle(around.jacobian_t_m, joints * m),
            lever_by=by_angle(levers, joints * joints),
            weight_by=by_angle(weights, joints),
        )

    def _give(self, about: _Expansion, weight: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """r_s(f): constant (B, 2N, 1), quadratic (B, N, 2, 2N, 2), linear (B, N, 2N, 2) parts."""
        n, m = self.exact.kinematics.segment_count, self.exact.kinematics.cable_count
        joints = 2 * n
        stiffness = weight / self.exact.compliance_m_n
        rows = about.jacobian_t.transpose(1, 2)
        soft = inverse(about.jacobian_t @ (rows * stiffness))
        pretension = weight * self.exact.pretension_n
        rest = soft @ (about.weight - about.jacobian_t @ pretension)
        tension = pretension + stiffness * (rows @ rest)
        give = soft @ about.lever.transpose(1, 2)
        pull = stiffness * (rows @ give)

        give_t, rest_t = give.transpose(1, 2), rest.transpose(1, 2)
        by_give = (give_t @ about.jacobian_by).reshape(-1, joints, joints, m)
        by_rest = (rest_t @ about.jacobian_by).reshape(-1, joints, m)
        constant = by_rest @ tension - (rest_t @ about.weight_by).transpose(1, 2)
        linear = (
            (by_give @ tension[:, None])[..., 0]
            + (by_rest @ pull).transpose(1, 2)
            - give_t @ about.weight_by
            - (rest_t @ about.lever_by).reshape(-1, joints, joints)
        )
        pulls = pull.reshape(-1, m, n, 2).transpose(1, 2)
        levers = (give_t @ about.lever_by).reshape(-1, n, 2, n, 2, joints)
        own_levers = torch.stack([levers[:, s, :, s] for s in range(n)], dim=1)
        bilinear = by_give.reshape(-1, n, 2, joints, m) @ pulls[:, :, None]
        return (
            constant,
            bilinear - own_levers.transpose(-1, -2),
            linear.reshape(-1, n, 2, joints).transpose(2, 3),
        )


def _of_products(blocks: Tensor) -> Tensor:
    """Coefficients (B, N, 3, c) of the products yy, yz, zz from bilinear ones (B, N, 2, c, 2)."""
    mixed = blocks[:, :, 0, :, 1] + blocks[:, :, 1, :, 0]
    return torch.stack([blocks[:, :, 0, :, 0], mixed, blocks[:, :, 1, :, 1]], dim=2)
