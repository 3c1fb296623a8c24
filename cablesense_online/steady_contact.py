"""A contact whose readings are averaged while its forces are steady, and the findings about it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from cablesense_base import Array

AVERAGED_EVERY_NS = 100_000_000
"""How often the average of a contact's readings is judged."""
_JUDGED_EVERY_NS, _SOONEST_NS = 2_000_000_000, 20_000_000
"""How often a contact is judged, which takes a millisecond, and how soon again if its tensions
respond differently."""
_SHARPER = 0.8
"""An unconfirmed contact is judged again when the limit has fallen below this share."""
_STEADY_N = 1.0
"""The average restarts when a force has changed by more."""
_LONGEST_GAP_NS = 500_000_000


@dataclass
class SteadyContact:
    """The readings of one or several contacts, averaged while their forces are steady.

    Attributes:
        segments: the touched segments.
        sum_n, count: sum of the readings (M,) less unloaded tensions, N, and their number.
        began_ns, last_ns: stamps of the first and the last of them.
        force_n: y and z of each force at the first of them.
        averaged_ns: stamp at which the average was last judged.
        passed: the last average (M,) of these forces, if it fitted, and the limit that it met.
        hidden, off_average: findings, as text; empty where there are none.
    """

    segments: tuple[int, ...]
    sum_n: Array
    count: int = 0
    began_ns: int = 0
    last_ns: int = 0
    force_n: tuple[float, ...] = ()
    averaged_ns: int = -AVERAGED_EVERY_NS
    passed: tuple[Array, float] | None = None
    hidden: str = ""
    off_average: str = ""
    _judged: tuple[object, int] = (None, -_JUDGED_EVERY_NS)
    _judged_by: float = math.inf

    def continues(self, segments: tuple[int, ...], stamp_ns: int) -> bool:
        """Whether a sample is of the same contact."""
        return segments == self.segments and 0 < stamp_ns - self.last_ns <= _LONGEST_GAP_NS

    def add(self, difference_n: Array, force_n: tuple[float, ...], stamp_ns: int) -> None:
        """Add readings less unloaded tensions (M,), and the forces that fit them, y and z each."""
        if not self.force_n or math.dist(force_n, self.force_n) > _STEADY_N:
            self.off_average, self.force_n, self.passed = "", force_n, None
            self.begin(stamp_ns)
        self.last_ns = stamp_ns
        self.sum_n += difference_n
        self.count += 1

    def begin(self, stamp_ns: int) -> None:
        """Begin a new average."""
        self.sum_n[:] = 0.0
        self.count, self.began_ns = 0, stamp_ns

    def to_be_judged(self, response: object, stamp_ns: int, largest: float) -> bool:
        """Whether readings with this response of the tensions are due, by a limit of misfits."""
        last, at_ns = self._judged
        if self.hidden and largest < _SHARPER * self._judged_by:
            return True
        return stamp_ns - at_ns >= (_JUDGED_EVERY_NS if response is last else _SOONEST_NS)

    def judge(self, response: object, stamp_ns: int, hidden: str, largest: float) -> None:
        """Take a finding."""
        self._judged, self._judged_by, self.hidden = (response, stamp_ns), largest, hidden
