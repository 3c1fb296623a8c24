"""In which directions a force across a link is felt, whatever the place and the pose.

Where all hinges before a link are parallel, a force along them makes no torque on any. Where the
only two cables of a rod run in one plane, a force across that plane bends the rod and stretches
neither. Such a force is not read, and a force on the link is known in the other direction alone.
"""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_contact.machine.observation import Observer
from cablesense_sim.machine.description import MachineError
from cablesense_sim.machine.simulated import SimulatedMachine

_POSES = 4
"""Poses beside the reference at which a direction must not be felt either."""
_AWAY_RAD = 0.1
"""These have hinges within so much of the reference, and slides where they are there."""
_UNFELT = 0.02
"""A direction is not felt if a force in it changes readings by less than this share of what one in
the other direction does: taken for nothing, it makes no larger error of that one."""


def felt_across(observer: Observer) -> Array:
    """(N, 2, 2) projections of forces across the links to their felt part.

    Forces are along y and z of the links' axis frames. A projection is the identity where both
    directions are felt, or none is.
    """
    changes = np.concatenate(_changes_of_readings(observer), axis=2)
    parts = np.linalg.svd(changes, full_matrices=False)
    largest = parts.S[:, 0]
    smallest = parts.S[:, 1]
    in_plane = (smallest <= _UNFELT * largest) & (largest > 0.0)
    projections = np.tile(np.eye(2), (len(largest), 1, 1))
    felt = parts.U[in_plane, :, 0]
    projections[in_plane] = felt[:, :, None] * felt[:, None, :]
    return projections


def is_planar(projections: Array) -> Array:
    """(N,) whether one direction across a link is felt alone, by `felt_across` (N, 2, 2)."""
    return np.asarray(np.linalg.det(projections) < 0.5)


def _changes_of_readings(observer: Observer) -> list[Array]:
    """(N, 2, D) by forces across each of N links, in some poses, at both ends of its range.

    Each of D observations is in deviations of the sensors' noise.
    """
    machine = observer.machine
    parameters = observer.parameters
    exact = np.zeros(len(parameters))
    nominal = SimulatedMachine(machine, parameters, exact)
    count = len(machine.coordinates)
    rng = np.random.default_rng(0)
    offsets = _AWAY_RAD * machine.coordinates.is_hinge * rng.uniform(-1.0, 1.0, (_POSES, count))
    changes = []
    for pose in machine.reference + np.concatenate([np.zeros((1, count)), offsets]):
        try:
            command = observer.command_of(pose)
            reading = nominal.untouched(command).values
            seen = observer.observe(
                reading, command, exact, np.zeros((len(exact),) * 2), np.zeros((count, count))
            )
        except MachineError:
            continue
        by_torque = np.linalg.cholesky(seen.information).T @ seen.by_torque
        for end_m in machine.links.touched_m.T:
            levers = seen.levers[:, 1:3] + end_m[:, None, None] * seen.levers[:, 4:6]
            changes.append(levers @ by_torque.T)
    return changes
