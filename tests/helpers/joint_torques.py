"""Joint torques of weight and loads in NumPy: the reference of the compiled ones."""

import numpy as np

from cablesense_sim import kinematics
from cablesense_sim.mechanism import Mechanism


def axis_torques_n_m(pose: kinematics.SegmentChain, load_arms_n_m: np.ndarray) -> np.ndarray:
    """Of generalised forces (..., N, 3) on the segments' axis vectors; (..., 2N)."""
    moment = np.cross(pose.rotation[..., 0], load_arms_n_m)
    distal = np.cumsum(moment[..., ::-1, :], axis=-2)[..., ::-1, :]
    return (pose.joint_axis * np.repeat(distal, 2, axis=-2)).sum(axis=-1)


def load_torques_n_m(mechanism: Mechanism, q: np.ndarray, forces_n=0.0) -> np.ndarray:
    """Of gravity and of contact forces (..., N, 3), if any, at joint angles (..., 2N)."""
    forces_n = np.zeros((*q.shape[:-1], mechanism.segment_count, 3)) + forces_n
    pose = kinematics.chain(mechanism, q)
    arms = kinematics.load_arms(mechanism, forces_n)
    return axis_torques_n_m(pose, arms)
