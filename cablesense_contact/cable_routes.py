"""Where cables run over guides: what their slides follow from, whatever the machine.

M cables pass G guides, one after the other from the actuators on, with a piece before each guide
and one behind the last: piece 0 is the run before guide 0, piece g + 1 lies behind guide g. The
actuator holds the beginning of the run, and the end of the last piece is fixed to a link.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

from cablesense_base import Array

MOVED_STD = 5.0
"""A cable has moved if its reading has changed by this many deviations of a reading."""


class OnTheWay(NamedTuple):
    """What cables are like at K commands of a motion, one after the other.

    Attributes:
        length_m: (K, M, G + 1) of the pieces.
        wrap_rad: (K, M, G) by which cables turn at the guides.
    """

    length_m: Array
    wrap_rad: Array


class CableRoutes(Protocol):
    """The routes of M cables of a machine with n coordinates over G guides."""

    @property
    def compliance_m_n(self) -> Array:
        """(M, G + 1) of the pieces."""
        ...

    @property
    def pretension_n(self) -> Array:
        """(M,) of the cables."""
        ...

    @property
    def moved_n(self) -> float:
        """Change of a reading that shows that a cable has moved."""
        ...

    @property
    def are_followed(self) -> bool:
        """Whether commands and readings tell how cables slide."""
        ...

    @property
    def returning(self) -> float:
        """Probability that a cable slid there and back on its way, as no reading shows."""
        ...

    def on_the_way(self, from_command: Array, to_command: Array, steps: int) -> OnTheWay:
        """Pieces and guides on a straight way between commands (C,), in steps."""
        ...

    def slope_m(self, command: Array) -> Array:
        """(M, G + 1, n) derivatives of the pieces' lengths by the coordinates at a command."""
        ...

    def wrap_rad(self, command: Array) -> Array:
        """(M, G) by which cables turn at the guides at a command."""
        ...
