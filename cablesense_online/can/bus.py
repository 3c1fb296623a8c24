"""A CAN interface: opening, error state, clock, CANopen node control, and the count of faults.

`CanInterface` opens any interface of python-can. `BusState` follows the controller's error state
by error frames, whose classes are those of SocketCAN (`linux/can/error.h`); python-can passes
them on in a frame's id and data. Other interfaces send error frames with codes of their own, or
none. `BusClock` turns bus timestamps into this machine's time. `FaultKind` is the table of faults
between a sensor and a sample; `FaultLedger` counts them for diagnostics.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from math import isfinite
from threading import Lock
from typing import Any

import can

from cablesense_base import CableSenseError

INTERFACES = ("socketcan", "slcan", "pcan", "kvaser", "virtual", "udp_multicast")
"""Those that are tried or documented here; python-can's others may well work."""
NMT_ID = 0x000
START_REMOTE_NODE = 0x01
HEARTBEAT_ID = 0x700
CONTROLLER_CLASS, BUS_OFF_CLASS, BUS_ERROR_CLASS, RESTARTED_CLASS = 0x04, 0x40, 0x80, 0x100
_CLASSES = {
    0x01: "transmit timeout",
    0x02: "lost arbitration",
    CONTROLLER_CLASS: "controller",
    0x08: "protocol violation",
    0x10: "transceiver",
    0x20: "no acknowledge",
    BUS_OFF_CLASS: "bus off",
    BUS_ERROR_CLASS: "bus error",
    RESTARTED_CLASS: "controller restarted",
}
_CONTROLLER_BITS = {
    0x01: "receive buffer overflow",
    0x02: "transmit buffer overflow",
    0x04: "receive warning",
    0x08: "transmit warning",
    0x10: "receive passive",
    0x20: "transmit passive",
    0x40: "active again",
}

SAME_CLOCK_S = 0.05
"""Timestamps that lag this machine's clock by no more are of that clock, as SocketCAN's are."""
DRIFT = 200e-6
"""The most by which two quartz clocks drift apart, with a margin."""
JUMP_S = 2.0
"""A lag that changes by more than this at once is a clock that was set, not a busy machine."""


class CanInterfaceError(CableSenseError):
    """A CAN interface that cannot be opened: names it, why, and what to look at."""


@dataclass(frozen=True)
class CanInterface:
    """One interface.

    Attributes:
        interface: python-can's name of the kind of adapter.
        channel: `can0`, `/dev/ttyACM0`, … as that kind names its channels.
        bitrate_bit_s: of the bus; 0 where the system sets it (SocketCAN) or there is none.
    """

    interface: str
    channel: str
    bitrate_bit_s: int = 0

    def __post_init__(self) -> None:
        """Raise CanInterfaceError where the kind is unknown to python-can, or no channel given."""
        if self.interface not in can.VALID_INTERFACES:
            raise CanInterfaceError(
                f"interface {self.interface[:40]!r} is unknown to python-can; it must be one of "
                f"{', '.join(INTERFACES)}"
            )
        if not self.channel:
            raise CanInterfaceError(
                f"interface {self.interface} needs a channel, such as can0 or /dev/ttyACM0"
            )

    @property
    def name(self) -> str:
        """For people and diagnostics."""
        return f"{self.interface} {self.channel}"

    @property
    def stamps_frames(self) -> bool:
        """Whether frames bear the time they were on the bus; over slcan it is when they are read.

        (Lawicel's protocol has a stamp of 16 bits, which python-can does not ask for.)
        """
        return self.interface != "slcan"

    @property
    def classes_errors(self) -> bool:
        """Whether error frames bear SocketCAN's classes in their id.

        Other drivers put codes of their own there. `virtual` passes on the emulator's frames.
        """
        return self.interface in ("socketcan", "virtual")

    def open(self) -> can.BusABC:
        """Open it.

        Raises:
            CanInterfaceError: it is not there, busy, or its driver is not installed.
        """
        options: dict[str, Any] = {"bitrate": self.bitrate_bit_s} if self.bitrate_bit_s else {}
        if self.interface == "slcan":
            options["sleep_after_open"] = 0.0
        try:
            bus = can.Bus(
                channel=self.channel, interface=self.interface, ignore_config=True, **options
            )
            if self.interface == "slcan":
                bus.flush()  # type: ignore[attr-defined]  # frames from before opening are old
            return bus
        except Exception as error:  # each adapter's driver raises errors of its own
            reason = " ".join(str(error).split())[:300] or type(error).__name__
            raise CanInterfaceError(f"{self.name} cannot be opened ({reason})") from error


class BusCondition(Enum):
    """The controller's error state (ISO 11898-1); the value is its name in diagnostics."""

    ACTIVE = "error active"
    WARNING = "error warning"
    PASSIVE = "error passive"
    OFF = "bus off"


_CONDITIONS = (
    (0x30, BusCondition.PASSIVE),
    (0x0C, BusCondition.WARNING),
    (0x40, BusCondition.ACTIVE),
)
"""By bits of a controller frame; the first that applies counts."""


class BusState:
    """Follows the error state of the bus.

    Attributes:
        condition: the present one.
        recoveries: how often the controller came back from bus off.
    """

    def __init__(self, place: str, classes: bool, ledger: FaultLedger) -> None:
        """`place` names the interface; `classes` is whether its error frames bear classes.

        Without classes error frames are counted, and the condition stays active.
        """
        self._place = place
        self._classes = classes
        self._ledger = ledger
        self.condition = BusCondition.ACTIVE
        self.recoveries = 0

    def error_frame(self, arbitration_id: int, data: bytes) -> None:
        """Take an error frame in.

        A controller that is off the bus neither sends nor receives until it is restarted: by the
        kernel after `restart-ms`, by an adapter's own rule, or by reopening it.
        """
        if not self._classes:
            self._ledger.note(FaultKind.ERROR_FRAME, self._place, "an error frame without class")
            return
        bits = data[1] if arbitration_id & CONTROLLER_CLASS and len(data) > 1 else 0
        parts = [part for bit, part in _CLASSES.items() if arbitration_id & bit]
        parts += [part for bit, part in _CONTROLLER_BITS.items() if bits & bit]
        text = ", ".join(parts) or f"error frame of class 0x{arbitration_id:X}"
        if arbitration_id & BUS_OFF_CLASS:
            if self.condition is not BusCondition.OFF:
                self._ledger.note(FaultKind.BUS_OFF, self._place, text)
            self.condition = BusCondition.OFF
            return
        self._ledger.note(FaultKind.ERROR_FRAME, self._place, text)
        if arbitration_id & RESTARTED_CLASS:
            self.data_frame()
            self.condition = BusCondition.ACTIVE
        if self.condition is not BusCondition.OFF:
            for mask, condition in _CONDITIONS:
                if bits & mask:
                    self.condition = condition
                    break

    def data_frame(self) -> None:
        """A data frame came, so the controller is on the bus."""
        if self.condition is BusCondition.OFF:
            self.recoveries += 1
            self.condition = BusCondition.ACTIVE


class BusClock:
    """Gives every frame's time by this machine's clock.

    Adapters stamp by this machine's clock, or by their own, which starts when they do. From the
    latter the smallest lag of arrival behind stamp is taken off: it is the clocks' distance plus
    the shortest delay, and follows their drift. Frames without a usable stamp count from arrival.
    """

    def __init__(self) -> None:
        self._lag_s: float | None = None
        self._last_now_s = 0.0

    def time_s(self, stamp_s: float, now_s: float) -> float:
        """The frame's time of its bus stamp and its arrival `now_s`, s since the epoch."""
        if not isfinite(stamp_s) or stamp_s <= 0.0:
            return now_s
        lag_s = now_s - stamp_s
        known_s = self._lag_s
        if known_s is None or lag_s - known_s > JUMP_S:
            self._lag_s = lag_s
        else:
            self._lag_s = min(lag_s, known_s + DRIFT * max(0.0, now_s - self._last_now_s))
        self._last_now_s = now_s
        same_clock = 0.0 <= self._lag_s <= SAME_CLOCK_S
        return stamp_s if same_clock else stamp_s + self._lag_s

    def restart(self) -> None:
        """The interface was opened again, and its clock may have started anew."""
        self._lag_s = None


def start_frames(nodes: Sequence[int]) -> list[can.Message]:
    """One NMT start (CiA 301) for each CANopen node, numbers 1 to 127."""
    return [
        can.Message(arbitration_id=NMT_ID, is_extended_id=False, data=[START_REMOTE_NODE, node])
        for node in nodes
    ]


def booted_node(frame: can.Message, nodes: Sequence[int]) -> int | None:
    """Which of the nodes has just got power, if the frame is its boot-up message.

    It then waits in the state pre-operational, and must be started again.
    """
    node = frame.arbitration_id - HEARTBEAT_ID
    plain = not (frame.is_extended_id or frame.is_remote_frame or frame.is_error_frame)
    return node if plain and node in nodes and bytes(frame.data) == b"\x00" else None


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
    """Faults since the report before.

    Attributes:
        recent: how many of each kind.
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
        """Count a fault of a cable, id, message or interface; the latest detail is kept."""
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
