"""Which forces a machine bears before a tendon goes slack."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_sim.machine.description import MachineError
from cablesense_sim.machine.simulated import AtRest, SimulatedMachine
from cablesense_sim.machine.statics import LinkForce

_DIRECTIONS = 8
"""Across a link, at equal angles."""
_HALVINGS = 7
"""Of the interval that holds the answer: it is then known to a hundredth of the largest force."""


def borne_n(simulated: SimulatedMachine, command: Array) -> Array:
    """(N,) forces across the far end of each link that slacken no tendon that is read.

    The least over directions, at a command (C,), and at most `touch.largest_n`. A machine whose
    tendons are not read bears every force in this sense.

    Raises:
        MachineError: it finds no rest untouched.
    """
    machine = simulated.machine
    largest_n = machine.source.file.touch.largest_n
    untouched = simulated.untouched(command)
    angles = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    directions = np.stack([0.0 * angles, np.cos(angles), np.sin(angles)], axis=1)
    borne = np.full(len(machine.links.names), largest_n)
    if not (machine.channels.tendon >= 0).any():
        return borne
    for link, (_, far_m) in enumerate(machine.links.touched_m):
        at_m = np.array([float(far_m), 0.0, 0.0])
        for direction in directions:
            if not _slackens(simulated, command, untouched, link, at_m, borne[link] * direction):
                continue
            low_n = 0.0
            high_n = float(borne[link])
            for _ in range(_HALVINGS):
                middle_n = 0.5 * (low_n + high_n)
                force_n = middle_n * direction
                if _slackens(simulated, command, untouched, link, at_m, force_n):
                    high_n = middle_n
                else:
                    low_n = middle_n
            borne[link] = low_n
    return borne


def _slackens(
    simulated: SimulatedMachine,
    command: Array,
    untouched: AtRest,
    link: int,
    at_m: Array,
    force_n: Array,
) -> bool:
    """Whether a tendon that is read has no tension left, or no rest is found."""
    try:
        loaded = simulated.touched(command, [LinkForce(link, at_m, force_n)], untouched)
    except MachineError:
        return True
    tendons = simulated.machine.channels.tendon
    return bool((loaded.tensions_n[tendons[tendons >= 0]] <= 0.0).any())
