"""The count of faults by kind and place, written by the receiving thread, read by diagnostics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from threading import Lock

from cablesense_ros.can.fault import FaultKind

PLACES_KEPT = 32
"""Places counted by name for each kind; a bus full of unknown ids must not fill the memory."""

ELSEWHERE = "elsewhere"


@dataclass(frozen=True)
class FaultReport:
    """Faults of a stretch of time.

    Attributes:
        recent: how many of each kind since the report before.
        places: of these, how many at each place (a cable, an id, a message).
        total: how many of each kind in all.
        last: the latest detail of each kind.
    """

    recent: Mapping[FaultKind, int]
    places: Mapping[FaultKind, Mapping[str, int]]
    total: Mapping[FaultKind, int]
    last: Mapping[FaultKind, str]


class FaultLedger:
    """Counts faults; safe to use from two threads."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._places: dict[FaultKind, Counter[str]] = {}
        self._total: Counter[FaultKind] = Counter()
        self._last: dict[FaultKind, str] = {}

    def note(self, kind: FaultKind, place: str, detail: str = "", count: int = 1) -> None:
        """Count a fault.

        Args:
            kind: what went wrong.
            place: where: the cable, id, message or interface.
            detail: a sentence for people; the latest of a kind is kept.
            count: how many at once.
        """
        with self._lock:
            places = self._places.setdefault(kind, Counter())
            known = place in places or len(places) < PLACES_KEPT
            places[place if known else ELSEWHERE] += count
            self._total[kind] += count
            self._last[kind] = detail or place

    def total(self, kind: FaultKind) -> int:
        """How many of a kind so far."""
        with self._lock:
            return self._total[kind]

    def report(self) -> FaultReport:
        """The faults since this was last asked; totals go on."""
        with self._lock:
            places, self._places = self._places, {}
            return FaultReport(
                recent={kind: counted.total() for kind, counted in places.items()},
                places=places,
                total=dict(self._total),
                last=dict(self._last),
            )
