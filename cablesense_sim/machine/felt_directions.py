"""In which directions a force across a link is felt, whatever the place and the pose.

Where all hinges before a link are parallel, a force along them makes no torque on any. Nothing
that is read then depends on it, and a force on the link is known in the plane of the others alone.
"""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.statics import MachineStatics

_POSES = 4
"""Poses beside the reference at which a direction must not be felt either."""
_AWAY = 0.2
"""These are within so many radians, and a tenth of that in metres, of the reference."""
_SLIDE_SHARE = 0.1
_UNFELT = 1e-6
"""A direction is not felt if it makes a smaller share of the force that the other one makes."""


def felt_across(machine: Machine) -> Array:
    """(N, 2, 2) projections of forces across the links to their felt part.

    Forces are along y and z of the links' frames. A projection is the identity where both
    directions are felt, or none is.
    """
    statics = MachineStatics(machine)
    rng = np.random.default_rng(0)
    away = np.where(machine.coordinates.is_hinge, _AWAY, _SLIDE_SHARE * _AWAY)
    offsets = away * rng.uniform(-1.0, 1.0, (_POSES, len(away)))
    levers = []
    for pose in machine.reference + np.concatenate([np.zeros((1, len(away))), offsets]):
        statics.at(pose)
        frames = statics.links()
        turn = frames.axes.transpose(0, 2, 1)
        by_force = (turn @ frames.by_force_m)[:, 1:]
        by_moment = (turn @ frames.by_moment)[:, 1:]
        # a force (f_y, f_z) at s along the link adds the moment s (-f_z, f_y)
        slope = np.stack([by_moment[:, 1], -by_moment[:, 0]], axis=1)
        levers += [by_force, slope]
    directions, sizes, _ = np.linalg.svd(np.concatenate(levers, axis=2), full_matrices=False)
    projections = np.tile(np.eye(2), (len(sizes), 1, 1))
    in_plane = (sizes[:, 1] <= _UNFELT * sizes[:, 0]) & (sizes[:, 0] > 0.0)
    felt = directions[in_plane, :, 0]
    projections[in_plane] = felt[:, :, None] * felt[:, None, :]
    return projections


def is_planar(projections: Array) -> Array:
    """(N,) whether one direction across a link is felt alone, by `felt_across` (N, 2, 2)."""
    return np.asarray(np.linalg.det(projections) < 0.5)
