"""Where cables run over guides: what their slides follow from, whatever the machine.

M cables pass G guides, one after the other from the actuators on, with a piece before each guide
and one behind the last: piece 0 is the run before guide 0, piece g + 1 lies behind guide g. The
actuator holds the beginning of the run, and the end of the last piece is fixed to a link.
"""

from __future__ import annotations

from typing import Protocol

from cablesense_base import Array

MOVED_STD = 5.0
"""A cable has moved if its reading has changed by this many deviations of a reading."""


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
    def wrap_rad(self) -> Array:
        """(M, G) by which a cable turns at a guide, as far as that counts for when it slides."""
        ...

    @property
    def moved_n(self) -> float:
        """Change of a reading that shows that a cable has moved."""
        ...

    @property
    def are_followed(self) -> bool:
        """Whether commands and readings tell how cables slide."""
        ...

    def on_the_way_m(self, from_command: Array, to_command: Array, steps: int) -> Array:
        """(steps + 1, M, G + 1) lengths of pieces on a straight way between commands (C,)."""
        ...

    def slope_m(self, command: Array) -> Array:
        """(M, G + 1, n) derivatives of the pieces' lengths by the coordinates at a command."""
        ...

    def bends_rad(self, command: Array) -> Array:
        """(M, G) by which cables turn at the guides at a command."""
        ...
