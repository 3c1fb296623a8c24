"""Poses and loads of an arm, drawn at random."""

from typing import NamedTuple

import numpy as np

from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import normal_force_n
from cablesense_sim.mechanism import Mechanism

STIFF = mechanism_of(open_arm("cdsm"))
SOFT = mechanism_of(open_arm("cdsm_lab"))
STRAIGHT = np.zeros(8)


class Cases(NamedTuple):
    """(C, 2N) commands, and (C, N, 3) forces on the segments."""

    command_rad: np.ndarray
    forces_n: np.ndarray


def random_cases(
    mechanism: Mechanism, count: int, degrees: float, contacts: int, largest_n: float = 200.0
) -> Cases:
    """Poses within ±degrees, each with one to `contacts` contacts on different segments."""
    rng = np.random.default_rng(5)
    command = np.deg2rad(rng.uniform(-degrees, degrees, (count, mechanism.joint_count)))
    order = rng.random((count, mechanism.segment_count)).argsort(axis=1)
    touched = order < rng.integers(1, contacts + 1, (count, 1))
    forces = np.zeros((count, mechanism.segment_count, 3))
    for n in range(mechanism.segment_count):
        magnitude = rng.uniform(0, largest_n, count) * touched[:, n]
        forces += normal_force_n(mechanism, command, n + 1, rng.uniform(0, 360, count), magnitude)
    return Cases(command, forces)


HARD = random_cases(STIFF, 2000, degrees=20, contacts=4)
"""Far bent and on all segments at once, many with slack cables."""
