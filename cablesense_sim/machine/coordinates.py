"""The independent joint positions of a machine, and those of joints that follow them.

A joint that an equality ties to another has the position q = q_0 + c(p - p_0), a polynomial of its
leader's. With all n independent positions r, q = q(r), and a torque on all joints is the
generalised force E' τ of the coordinates, E = ∂q/∂r.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, some_of
from cablesense_sim.machine.description import MachineError
from cablesense_sim.mujoco_file import JointTie, joint_ties


@dataclass(frozen=True)
class Coordinates:
    """The n independent positions of a machine with nq joints, each a hinge or a slide.

    Attributes:
        names: of their joints.
        joints: (n,) numbers of their joints.
        is_hinge: (n,) whether they are angles.
        held: (nq,) positions of joints that are locked, where the reference pose has them.
        ties: those of joints that follow others, leaders first.
    """

    names: tuple[str, ...]
    joints: NDArray[np.int64]
    is_hinge: NDArray[np.bool_]
    held: Array
    ties: tuple[JointTie, ...]

    def __len__(self) -> int:
        return len(self.joints)

    def independent(self, qpos: Array) -> Array:
        """The coordinates (..., n) of positions (..., nq)."""
        return qpos[..., self.joints]

    def positions(self, values: Array) -> Array:
        """Positions (nq,) of all joints by coordinates (n,)."""
        qpos = self.held.copy()
        qpos[self.joints] = values
        for tie in self.ties:
            leading = qpos[tie.leader] if tie.leader is not None else np.zeros(())
            qpos[tie.joint] = tie.followed(leading)
        return qpos

    def slope(self, qpos: Array) -> Array:
        """(nq, n) ∂q/∂r: of all joints' positions by the coordinates, at positions (nq,)."""
        slope = np.zeros((len(qpos), len(self)))
        slope[self.joints, np.arange(len(self))] = 1.0
        for tie in self.ties:
            if tie.leader is not None:
                slope[tie.joint] = tie.slope(qpos[tie.leader]) * slope[tie.leader]
        return slope


def coordinates_of(
    model: mujoco.MjModel, reference: Array, locked: Sequence[str], source: str
) -> Coordinates:
    """The coordinates of a model whose locked joints are where the reference (nq,) has them.

    Raises:
        MachineError: a locked joint is not there, or two equalities tie one
            joint, or joints follow each other in a circle.
    """
    names = [model.joint(j).name for j in range(model.njnt)]
    unknown = [name for name in locked if name not in names]
    if unknown:
        raise MachineError(
            f"{source}: locked names joint {some_of(unknown)}, which the model does not have; it "
            f"has {some_of(names)}"
        )
    ties = _leaders_first(joint_ties(model, source, MachineError), names, source)
    following = {tie.joint for tie in ties}
    joints = [j for j in range(model.njnt) if j not in following and names[j] not in locked]
    if not joints:
        raise MachineError(f"{source}: all joints are locked or follow others; none can give way")
    is_hinge = model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_HINGE
    return Coordinates(
        names=tuple(names[j] for j in joints),
        joints=np.array(joints, dtype=np.int64),
        is_hinge=np.asarray(is_hinge),
        held=reference.copy(),
        ties=tuple(ties),
    )


def _leaders_first(ties: Sequence[JointTie], names: Sequence[str], source: str) -> list[JointTie]:
    pending = {tie.joint: tie for tie in ties}
    ordered: list[JointTie] = []
    while pending:
        ready = [tie for tie in pending.values() if tie.leader not in pending]
        if not ready:
            circle = [names[joint] for joint in pending]
            raise MachineError(
                f"{source}: joints {some_of(circle)} follow each other in a circle; an equality "
                "ties a joint to one that does not follow it"
            )
        for tie in ready:
            ordered.append(pending.pop(tie.joint))
    return ordered
