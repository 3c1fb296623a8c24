"""Joint torques of weight and loads, as the kinematics has them in parts."""

from typing import Any

from array_api_compat import array_namespace

from cablesense_sim import kinematics
from cablesense_sim.mechanism import Mechanism


def load_torques_n_m(mechanism: Mechanism, q: Any, forces_n: Any) -> Any:
    """Of gravity and of contact forces (..., N, 3), at joint angles (..., 2N)."""
    pose, arms = kinematics.chain(mechanism, q), kinematics.load_arms(mechanism, forces_n)
    return kinematics.axis_torques_n_m(pose, arms)


def gravity_torques_n_m(mechanism: Mechanism, q: Any) -> Any:
    """Of the segments' weight, at joint angles (..., 2N)."""
    xp = array_namespace(q)
    none = xp.zeros((*q.shape[:-1], mechanism.segment_count, 3), dtype=q.dtype)
    return load_torques_n_m(mechanism, q, none)
