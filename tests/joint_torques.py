"""Joint torques of weight and loads, as the kinematics has them in parts."""

import numpy as np

from cablesense_sim import kinematics
from cablesense_sim.mechanism import Mechanism


def load_torques_n_m(mechanism: Mechanism, q: np.ndarray, forces_n: np.ndarray) -> np.ndarray:
    """Of gravity and of contact forces (..., N, 3), at joint angles (..., 2N)."""
    pose, arms = kinematics.chain(mechanism, q), kinematics.load_arms(mechanism, forces_n)
    return kinematics.axis_torques_n_m(pose, arms)


def gravity_torques_n_m(mechanism: Mechanism, q: np.ndarray) -> np.ndarray:
    """Of the segments' weight, at joint angles (..., 2N)."""
    return load_torques_n_m(mechanism, q, np.zeros((*q.shape[:-1], mechanism.segment_count, 3)))
