"""Which part of a tension change balances moments, and which only other cables.

On an arm at rest with taut cables, J(q)ᵀ ΔT is the change of the joint moments, whatever the
stiffness of the cables. What lies in the range of J carries moments; what is orthogonal to it
bends nothing. With three cables a segment that is one number a segment: all its cables tighter or
slacker by the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.arm import Arm
from cablesense_sim.kinematics import cable_jacobian_m
from cablesense_sim.mechanism import Mechanism

Array = NDArray[np.float64]


def moments_n_m(arm: Arm, changes_n: Array) -> Array:
    """Moments (K, 2N) about the joint axes that changes (K, M) carry on the straight arm, N·m."""
    return np.asarray(changes_n @ _jacobian_m(arm))


def internal_n(arm: Arm, changes_n: Array) -> Array:
    """The part (K, M) of changes (K, M) that carries no moment on the straight arm, N."""
    basis, _ = np.linalg.qr(_jacobian_m(arm))
    return np.asarray(changes_n - changes_n @ basis @ basis.T)


def _jacobian_m(arm: Arm) -> Array:
    return np.asarray(cable_jacobian_m(Mechanism.from_arm(arm), np.zeros(2 * arm.segment_count)))
