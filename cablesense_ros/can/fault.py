"""What can go wrong between a sensor and a sample; each kind is counted and has one behaviour."""

from __future__ import annotations

from enum import Enum


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
