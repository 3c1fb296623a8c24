"""What can go wrong between a sensor and a sample; each kind is counted and has one behaviour.

The count of faults by kind and place, written by the receiving thread, read by diagnostics.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from threading import Lock


class FaultKind(Enum):
    """A kind of fault; the value is what diagnostics call it."""

    MISSING_CHANNEL = "missing channel"
    LATE_CHANNEL = "late channel"
    COUNTER_GAP = "counter gap"
    WRONG_LENGTH = "wrong length"
    UNKNOWN_ID = "unknown id"
    UNREADABLE = "unreadable frame"
    ERROR_FRAME = "error frame"
    BUS_OFF = "bus off"
    OVER_RANGE = "over range"
    UNDER_RANGE = "under range"
    STUCK_VALUE = "stuck value"
    NOT_FINITE = "not finite"
    INVALID_STATUS = "invalid by its status"
    FLOODED = "flooded bus"
    SILENT_BUS = "silent bus"
    INTERFACE_LOST = "interface lost"


WITHHOLDS = frozenset(
    {
        FaultKind.MISSING_CHANNEL,
        FaultKind.LATE_CHANNEL,
        FaultKind.WRONG_LENGTH,
        FaultKind.UNREADABLE,
        FaultKind.BUS_OFF,
        FaultKind.OVER_RANGE,
        FaultKind.UNDER_RANGE,
        FaultKind.STUCK_VALUE,
        FaultKind.NOT_FINITE,
        FaultKind.INVALID_STATUS,
        FaultKind.SILENT_BUS,
        FaultKind.INTERFACE_LOST,
    }
)
"""Kinds that cost samples; the others are reported and the samples go on."""


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
