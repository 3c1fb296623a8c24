"""The closed form of a stiff arm, to second order in its give: a thousand answers a second.

On a stiff arm the joints deflect by a few milliradians. `ClosedForm` computes everything anew at
the true pose; here it is expanded about the commanded one. Kinematics are linear in the joints'
give, and cable lengths quadratic. The expansion depends on the command alone, and the matrices
that give the pose depend on that and on which cables are taut: an estimator computes both as
seldom as they change (`inference.session`).
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from cablesense_sim.mechanism import Mechanism
from cablesense_training.networks.closed_form import (
    POSE_SLACK_WEIGHT,
    SLACK_WEIGHT,
    Balance,
    ClosedForm,
    gram_inverse,
    missing_of,
    weights,
)
from cablesense_training.networks.compact import CompactPose

_STEP_RAD = 1e-4
"""Step of the central differences by the pose; their error is a part in 1e8."""


class NearCommand(ClosedForm):
    """`ClosedForm` with fewer operations a sample, for arms of one pose correction.

    It is without joint springs, and the actuators hold the lengths of the arm itself. The
    `jacobian_t_m` of its balance is that at the command.
    """

    offsets: Tensor

    def __init__(self, mechanism: Mechanism, *statics: Any, **options: Any) -> None:
        super().__init__(mechanism, *statics, **options)
        forward = _STEP_RAD * torch.eye(mechanism.joint_count, dtype=torch.float64)
        self.register_buffer("offsets", torch.cat([forward, -forward]))

    def forward(self, tension_difference_n: Tensor, joint_command_rad: Tensor) -> Balance:
        """See the base class."""
        n, m = self.kinematics.segment_count, self.kinematics.cable_count
        joints = 2 * n
        commanded = self.kinematics(joint_command_rad)
        unloaded_n, unbalanced = self.unloaded(joint_command_rad, commanded)
        at, by_angle = self._expand(joint_command_rad, commanded)
        jacobian, bend_by = commanded.jacobian_t_m, by_angle[:, :, : joints * m]

        tension = self.as_tensions(tension_difference_n) + unloaded_n
        # all that depends on which cables are taut does so through this one tensor
        taut = (tension > self.slack_below_n).to(tension.dtype)
        tension = tension * taut
        of_pose = weights(taut, POSE_SLACK_WEIGHT)
        to_turn = (gram_inverse(jacobian, of_pose) @ (jacobian * of_pose[:, None])).transpose(1, 2)
        gram = gram_inverse(jacobian, weights(taut, SLACK_WEIGHT))

        stretch = ((tension - self.pretension_n) * self.compliance_m_n)[:, None]
        turn = stretch @ to_turn
        half_bent = (turn @ bend_by).reshape(-1, joints, m) * 0.5 + jacobian
        turn = turn + (stretch - turn @ half_bent) @ to_turn
        sizes = [joints * m, 3 * n * joints, 3 * n * joints, n * joints, joints]
        bent, by_force, by_place, by_twist, own_weight = (
            part[:, 0] for part in (turn @ by_angle + at[:, None]).split(sizes, dim=2)
        )
        bent = bent.reshape(-1, joints, m)
        missing = missing_of((stretch - turn @ (bent + jacobian) * 0.5)[:, 0], taut)
        torque = (bent @ tension[..., None])[..., 0] - own_weight - unbalanced
        precision = gram * (1.0 / self.reading_variance_n2)
        return Balance(
            torque,
            precision,
            by_force.reshape(-1, n, 3, joints),
            by_place.reshape(-1, n, 3, joints),
            by_twist.reshape(-1, n, joints),
            self.residual(missing, jacobian, precision, taut),
            taut,
            tension,
            jacobian,
            commanded.length_m,
        )

    def _expand(self, command_rad: Tensor, commanded: CompactPose) -> tuple[Tensor, Tensor]:
        """Kinematics (B, K) at the command, flattened, and derivatives (B, 2N, K) by the angles.

        They are the Jacobian, torques by force, place and twist, and those of the weight, by
        central differences.
        """
        joints = 2 * self.kinematics.segment_count
        around = self.kinematics((command_rad[:, None] + self.offsets).reshape(-1, joints))
        frames = commanded.frames[:, None] + 0.0 * self.offsets[:, :1, None]
        at = self._flat(commanded, commanded.frames)
        sides = self._flat(around, frames.flatten(0, 1)).reshape(-1, 2, joints, at.shape[1])
        return at, (sides[:, 0] - sides[:, 1]) * (0.5 / _STEP_RAD)

    def _flat(self, pose: CompactPose, frames: Tensor) -> Tensor:
        levers, weight = self.kinematics.levers(pose, frames), self.kinematics.weight_n_m(pose)
        parts = [pose.jacobian_t_m, *levers, weight]
        return torch.cat([part.reshape(-1, part[0].numel()) for part in parts], dim=1)
