"""Arrays to and from `sensor_msgs/JointState`, whatever the order of its names.

Tensions are efforts, joint angles positions.
"""

from __future__ import annotations

import array
import math
from collections import Counter
from collections.abc import Sequence
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_base.errors import some_of
from cablesense_msgs_py.topics import ContractError


class NamedOrder:
    """Arranges named values in the order of `names`, whatever order they come in.

    A message that repeats the names of the one before costs one comparison and one indexing.
    """

    def __init__(self, names: Sequence[str], what: str) -> None:
        """`names` is the order wanted; `what` says in errors what they name ("cables")."""
        self.names = tuple(names)
        self._what = what
        self._last_names: tuple[str, ...] = self.names
        self._getter: itemgetter[tuple[float, ...]] | None = None

    def arrange(
        self, names: Sequence[str], values: Sequence[float], field: str
    ) -> NDArray[np.float64]:
        """The values in the order wanted, as an array.

        Raises:
            ContractError: as `pick`.
        """
        return np.array(self.pick(names, values, field), dtype=np.float64)

    def pick(self, names: Sequence[str], values: Sequence[float], field: str) -> tuple[float, ...]:
        """The values in the order wanted, as they are.

        Args:
            names: as the message has them.
            values: one per name.
            field: the message field the values come from, for errors.

        Raises:
            ContractError: a name is missing, unknown or repeated, or there is not one value per
                name.
        """
        given = tuple(names)
        if given != self._last_names:
            self._getter = self._make_getter(given)
            self._last_names = given
        if len(values) != len(given):
            raise ContractError(
                f"{field} holds {len(values)} values for {len(given)} names; "
                f"it must hold one per name ({len(self.names)})"
            )
        return tuple(values) if self._getter is None else self._getter(values)

    def _make_getter(self, given: tuple[str, ...]) -> itemgetter[tuple[float, ...]] | None:
        if given == self.names:
            return None
        problems = self._problems(given)
        if problems:
            raise ContractError(
                f"name: {'; '.join(problems)}; the {len(self.names)} {self._what} of this arm are "
                f"{self.names[0]} … {self.names[-1]}, in any order, each once"
            )
        where = {name: position for position, name in enumerate(given)}
        return itemgetter(*(where[name] for name in self.names))

    def _problems(self, given: tuple[str, ...]) -> list[str]:
        counts = Counter(given)
        found = {
            "missing": [name for name in self.names if name not in counts],
            "unknown": [name for name in counts if name not in self.names],
            "more than once": [name for name, count in counts.items() if count > 1],
        }
        return [
            f"{kind} {some_of([repr(name[:40]) for name in names])}"
            for kind, names in found.items()
            if names
        ]


MAX_JOINT_ANGLE_RAD = math.radians(60.0)
"""Commands beyond this are refused: no universal joint between guide plates reaches it."""


def put_tensions(message: Any, tensions_n: NDArray[np.float64]) -> None:
    """Put (M,) tensions in N into a `JointState` whose names are set already."""
    message.effort = array.array("d", tensions_n.tolist())


def put_joint_angles(message: Any, angles_rad: NDArray[np.float64]) -> None:
    """Put (2N,) joint angles in rad into a `JointState` whose names are set already."""
    message.position = array.array("d", angles_rad.tolist())


def joint_command_rad(message: Any, order: NamedOrder) -> NDArray[np.float64]:
    """The (2N,) joint angles that a `JointState` commands, in the arm's order.

    Raises:
        ContractError: a joint is missing, unknown or repeated, or an angle is not finite or out of
        reach.
    """
    angles = order.arrange(message.name, message.position, "position")
    for name, angle in zip(order.names, angles, strict=True):
        if not abs(angle) <= MAX_JOINT_ANGLE_RAD:
            raise ContractError(
                f"position of {name} is {angle:g} rad; it must be finite and within "
                f"±{MAX_JOINT_ANGLE_RAD:.3f} rad (a third of pi)"
            )
    return angles
