"""A CAN interface: opening, error state of the bus, CANopen node control, and the count of faults.

Error frames have the classes of SocketCAN (`linux/can/error.h`), which python-can passes on in a
frame's id and data.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from threading import Lock
from typing import Any, NamedTuple

import can

from cablesense_base import CableSenseError

INTERFACES = ("socketcan", "slcan", "pcan", "kvaser", "virtual", "udp_multicast")
"""Interfaces that are tested or documented here; others of python-can may work too."""
NMT_ID = 0x000
"""CAN identifier of CANopen's network management (CiA 301)."""
START_REMOTE_NODE = 0x01
"""Its command that starts a node."""
HEARTBEAT_ID = 0x700
"""CAN identifier of a node's heartbeat, less the node's number (CiA 301)."""
CONTROLLER_CLASS = 0x04
"""Bits of SocketCAN's error classes (linux/can/error.h): of the controller,"""
BUS_OFF_CLASS = 0x40
"""of a controller that is off the bus,"""
BUS_ERROR_CLASS = 0x80
"""of an error on the bus,"""
RESTARTED_CLASS = 0x100
"""and of a controller that was restarted."""
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


class CanInterfaceError(CableSenseError):
    """A CAN interface that cannot be opened: names it, the reason and a remedy."""


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
        """Raise CanInterfaceError if python-can lacks the kind, or no channel is given."""
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
        """Whether frames have the time of the bus; over slcan they have the time of reading."""
        return self.interface != "slcan"

    @property
    def classes_errors(self) -> bool:
        """Whether error frames have SocketCAN's classes; `virtual` passes the emulator's on."""
        return self.interface in ("socketcan", "virtual")

    def open(self) -> can.BusABC:
        """Open the interface.

        Raises:
            CanInterfaceError: it does not exist, is busy, or its driver is not installed.
        """
        options: dict[str, Any] = {"bitrate": self.bitrate_bit_s} if self.bitrate_bit_s else {}
        if self.interface == "slcan":
            options["sleep_after_open"] = 0.0
        try:
            bus = can.Bus(
                channel=self.channel, interface=self.interface, ignore_config=True, **options
            )
            if self.interface == "slcan":
                bus.flush()  # type: ignore[attr-defined]  # discards frames from before opening
                bus.serialPortOrig = _InLines(bus.serialPortOrig)  # type: ignore[attr-defined]
            return bus
        except Exception as error:  # each adapter's driver raises its own errors
            reason = " ".join(str(error).split())[:300] or type(error).__name__
            raise CanInterfaceError(f"{self.name} cannot be opened ({reason})") from error


_LINE = re.compile(rb"[^\r\a]+|[\r\a]")


class _InLines:
    """A serial port read in blocks and lines: python-can makes a system call for each byte."""

    def __init__(self, port: Any) -> None:
        self._port = port
        self._lines = b""
        self._at = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    @property
    def write_timeout(self) -> float | None:
        """How long a write may take, s."""
        timeout_s: float | None = self._port.write_timeout
        return timeout_s

    @write_timeout.setter
    def write_timeout(self, timeout_s: float | None) -> None:
        self._port.write_timeout = timeout_s

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        return len(self._lines) - self._at or int(self._port.in_waiting)

    def read(self, _: int = 1) -> bytes:
        """A line without its end, or its end; waits as the port does.

        python-can asks for one byte, appends the answer, and compares it with the two ends.
        """
        if self._at == len(self._lines):
            self._lines = self._port.read(1) + self._port.read(self._port.in_waiting)
            self._at = 0
        line = _LINE.match(self._lines, self._at)
        if line is None:
            return b""
        self._at = line.end()
        return line.group()


class FaultKind(Enum):
    """A kind of fault between a sensor and a sample; its value is its name in diagnostics."""

    MISSING_CHANNEL = "missing channel"
    LATE_CHANNEL = "late channel"
    COUNTER_GAP = "counter gap"
    COUNTER_JUMP = "counter jump"
    DUPLICATE_ID = "duplicate id"
    DISTRUSTED_ID = "distrusted id"
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

    @property
    def withholds(self) -> bool:
        """Whether the fault costs samples; otherwise it is only reported."""
        kept = (FaultKind.COUNTER_GAP, FaultKind.UNKNOWN_ID, FaultKind.ERROR_FRAME)
        return self not in (*kept, FaultKind.FLOODED)


class FaultReport(NamedTuple):
    """Faults by kind.

    Attributes:
        recent: how often it occurred at each place (a cable, an id, a message) since the previous
            report.
        total: how often it has occurred in all.
        last: the latest detail.
    """

    recent: dict[FaultKind, Counter[str]]
    total: Counter[FaultKind]
    last: dict[FaultKind, str]


class FaultLedger:
    """Counts faults. It is thread-safe."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._faults = FaultReport({}, Counter(), {})

    def note(self, kind: FaultKind, place: str, detail: str = "") -> None:
        """Count a fault of a cable, id, message or interface, and keep its detail."""
        with self._lock:
            recent, total, last = self._faults
            recent.setdefault(kind, Counter())[place] += 1
            total[kind] += 1
            last[kind] = detail or place

    def report(self) -> FaultReport:
        """The faults since the previous report."""
        with self._lock:
            recent, total, last = self._faults
            self._faults = FaultReport({}, total.copy(), last.copy())
            return FaultReport(recent, total, last)


ERROR_ACTIVE = "error active"
BUS_OFF = "bus off"
_CONDITIONS = {0x30: "error passive", 0x0C: "error warning", 0x40: ERROR_ACTIVE}
"""Error state (ISO 11898-1) by the bits of a controller frame; the first that applies counts."""


class BusState:
    """Follows the error state of the bus.

    Attributes:
        condition: the present state, active if error frames have no classes.
        recoveries: how often the controller has come back from bus off.
    """

    def __init__(self, interface: CanInterface, ledger: FaultLedger) -> None:
        self._interface = interface
        self._ledger = ledger
        self.condition = ERROR_ACTIVE
        self.recoveries = 0

    def error_frame(self, arbitration_id: int, data: bytes) -> None:
        """Take an error frame.

        A controller in bus off neither sends nor receives until it is restarted: by the kernel
        after `restart-ms`, by the adapter, or by reopening it.
        """
        classes = arbitration_id if self._interface.classes_errors else 0
        named = [name for bit, name in _CLASSES.items() if classes & bit]
        text = ", ".join(named) or f"error frame 0x{arbitration_id:X} of no known class"
        if not classes & BUS_OFF_CLASS:
            self._ledger.note(FaultKind.ERROR_FRAME, self._interface.name, text)
        elif self.condition != BUS_OFF:
            self._ledger.note(FaultKind.BUS_OFF, self._interface.name, text)
            self.condition = BUS_OFF
        if classes & RESTARTED_CLASS:
            self.data_frame()
            self.condition = ERROR_ACTIVE
        if classes & CONTROLLER_CLASS and len(data) > 1 and self.condition != BUS_OFF:
            conditions = [condition for bits, condition in _CONDITIONS.items() if data[1] & bits]
            self.condition = conditions[0] if conditions else self.condition

    def data_frame(self) -> None:
        """Note that a data frame arrived, so the controller is on the bus."""
        if self.condition == BUS_OFF:
            self.recoveries += 1
            self.condition = ERROR_ACTIVE


def start_frames(nodes: Sequence[int]) -> list[can.Message]:
    """One NMT start (CiA 301) for each CANopen node, numbers 1 to 127."""
    return [
        can.Message(arbitration_id=NMT_ID, is_extended_id=False, data=[START_REMOTE_NODE, node])
        for node in nodes
    ]


def booted_node(frame: can.Message, nodes: Sequence[int]) -> int | None:
    """Which of the nodes sent this frame as its boot-up message, if any.

    After power-up a node is in the state pre-operational and must be started again.
    """
    node = frame.arbitration_id - HEARTBEAT_ID
    plain = not (frame.is_extended_id or frame.is_remote_frame or frame.is_error_frame)
    return node if plain and node in nodes and bytes(frame.data) == b"\x00" else None
