"""Faults between a sensor and a sample: their kinds as one table, and their count.

The receiving thread counts, diagnostics read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from threading import Lock

PLACES_KEPT = 32
"""Places counted by name for each kind; a bus full of unknown ids must not fill the memory."""

ELSEWHERE = "elsewhere"


class FaultKind(Enum):
    """A kind of fault; its value is its name in diagnostics.

    Attributes:
        withholds: whether it costs samples; otherwise it is reported and the samples go on.
        of_cable: whether it concerns one cable's channel; otherwise the whole bus.
    """

    #                  in diagnostics          withholds, of_cable
    MISSING_CHANNEL = ("missing channel", True, True)
    LATE_CHANNEL = ("late channel", True, True)
    COUNTER_GAP = ("counter gap", False, False)
    WRONG_LENGTH = ("wrong length", True, True)
    UNKNOWN_ID = ("unknown id", False, False)
    UNREADABLE = ("unreadable frame", True, True)
    ERROR_FRAME = ("error frame", False, False)
    BUS_OFF = ("bus off", True, False)
    OVER_RANGE = ("over range", True, True)
    UNDER_RANGE = ("under range", True, True)
    STUCK_VALUE = ("stuck value", True, True)
    NOT_FINITE = ("not finite", True, True)
    INVALID_STATUS = ("invalid by its status", True, True)
    FLOODED = ("flooded bus", False, False)
    SILENT_BUS = ("silent bus", True, False)
    INTERFACE_LOST = ("interface lost", True, False)

    withholds: bool
    of_cable: bool

    def __new__(cls, text: str, withholds: bool, of_cable: bool) -> FaultKind:
        """A row of the table."""
        kind = object.__new__(cls)
        kind._value_ = text
        kind.withholds, kind.of_cable = withholds, of_cable
        return kind


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

    def note(self, kind: FaultKind, place: str, detail: str = "") -> None:
        """Count a fault.

        Args:
            kind: what went wrong.
            place: where: the cable, id, message or interface.
            detail: a sentence for people; the latest of a kind is kept.
        """
        with self._lock:
            places = self._places.setdefault(kind, Counter())
            places[place if place in places or len(places) < PLACES_KEPT else ELSEWHERE] += 1
            self._total[kind] += 1
            self._last[kind] = detail or place

    def report(self) -> FaultReport:
        """The faults since the report before; totals go on."""
        with self._lock:
            places, self._places = self._places, {}
            recent = {kind: counted.total() for kind, counted in places.items()}
            return FaultReport(recent, places, dict(self._total), dict(self._last))
