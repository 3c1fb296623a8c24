"""A machine as a commissioning moves it: where it can go, and what it reads there unloaded.

`movable_arm.MovableArm` is an arm of an arm file, `movable_machine.MovableMachine` one that MuJoCo
describes.
"""

from __future__ import annotations

from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_contact.calibration import Calibration
from cablesense_contact.felt import FeltMachine
from cablesense_contact.reference_contacts import ReferenceContacts

TAUT_SHARE: Final = 0.2
"""A cable is taut for certain above this share of its pretension."""
DIRECTIONS: Final = 200
"""Directions of approach that are tried."""


class Movable(Protocol):
    """A machine with C numbers in a command, and M channels that read tensions."""

    @property
    def felt(self) -> FeltMachine:
        """What estimates know of it."""
        ...

    @property
    def taut_n(self) -> Array:
        """(M,) tensions above which a cable is taut for certain."""
        ...

    @property
    def rubs(self) -> bool:
        """Whether its file states friction, so that poses are reached from both sides."""
        ...

    @property
    def per_radian(self) -> float:
        """By how much a command changes at most where one joint turns, over that turn."""
        ...

    def candidates(self, count: int, reach_rad: float, rng: np.random.Generator) -> Array:
        """Commands (K, C) near its first one, within `reach_rad` of joints; K up to `count`."""
        ...

    def predicted_n(self, commands: Array, calibration: Calibration) -> Array:
        """Readings (K, M) without a load at commands (K, C); those of slack cables may be off."""
        ...

    def beside(self, approach_rad: float) -> Array:
        """(C,) a change of the command that moves every cable; no joint turns by more."""
        ...

    def farthest_m(self, start: Array, commands: Array) -> float:
        """How far its end, or any link's, moves from a command (C,) to one of others (K, C)."""
        ...

    def reference_contacts(self) -> ReferenceContacts:
        """The contacts by which it is told how well a force is known.

        Raises:
            CableSenseError: it does not bear them.
        """
        ...


def taut(movable: Movable, commands: Array, calibration: Calibration) -> NDArray[np.bool_]:
    """(K,) whether all cables are well above zero at commands (K, C)."""
    predicted_n = movable.predicted_n(commands, calibration)
    return np.asarray((predicted_n > movable.taut_n).all(axis=1))


def outward(drawn: Array, reach: Array | float) -> Array:
    """Half of drawn numbers (K, n) within ± `reach` (n,), nearer to the ends: these teach most."""
    pushed = drawn.copy()
    inner = len(drawn) // 2
    pushed[inner:] = np.sign(drawn[inner:]) * np.sqrt(np.abs(drawn[inner:]) * reach)
    return pushed
