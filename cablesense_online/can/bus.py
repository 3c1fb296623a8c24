"""Which CAN interface to open, and how (python-can's names).

Serial CAN adapters, read in bulk: python-can's `slcan` reads byte by byte.

At a thousand cycles of four frames a second the driver takes some 0.3 of a core instead of 0.7.

The protocol's lines bear no time, so a frame gets that of its reading. Frames that had to wait are
spread over the time since the reading before, in which they came: else all of a backlog would
bear one time, and nobody downstream could tell their order or their rate.

Frames as lines of the slcan protocol, and back (after Lawicel's CAN232 manual).

`t1234AABBCCDD` is id 123h with four bytes, `T` has an id of eight digits, `r` and `R` are remote
frames; the carriage return between lines is not part of them.

CANopen network management (CiA 301): amplifiers that send only once they were started.
"""

from __future__ import annotations

import re
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import can
from can.exceptions import error_check
from can.interfaces.slcan import slcanBus

from cablesense_base.errors import CableSenseError

FRAME_COMMANDS = b"tTrR"
MAX_LINE_BYTES = 64
"""More without an end is no line: the longest frame has 26 characters, and a stamp four."""

_STAMP_DIGITS = 4
_HEX = rb"[0-9A-Fa-f]"
_LINE = re.compile(rb"([tr])(%b{3})([0-8])(%b*)" % (_HEX, _HEX))
_LONG_LINE = re.compile(rb"([TR])(%b{8})([0-8])(%b*)" % (_HEX, _HEX))


def frame_line(frame: can.Message) -> bytes | None:
    """A frame as a line; None for error and CAN FD frames, which the protocol lacks."""
    if frame.is_error_frame or frame.is_fd:
        return None
    letter = "r" if frame.is_remote_frame else "t"
    if frame.is_extended_id:
        head = f"{letter.upper()}{frame.arbitration_id:08X}{frame.dlc:d}"
    else:
        head = f"{letter}{frame.arbitration_id:03X}{frame.dlc:d}"
    return (head if frame.is_remote_frame else head + bytes(frame.data).hex().upper()).encode()


def line_frame(line: bytes, time_s: float = 0.0) -> can.Message:
    """The frame of a line; a stamp of four digits at its end is left out.

    Args:
        line: begins with one of `FRAME_COMMANDS`, without its carriage return.
        time_s: what the frame's timestamp shall be.

    Raises:
        ValueError: the line is no frame; shows it.
    """
    match = _LINE.fullmatch(line) or _LONG_LINE.fullmatch(line)
    if match is not None:
        command, number, digit, digits = match.groups()
        extended, remote, length = command in b"TR", command in b"rR", int(digit)
        shown = 0 if remote else 2 * length
        fits = int(number, 16) < (1 << 29 if extended else 1 << 11)
        if fits and len(digits) in (shown, shown + _STAMP_DIGITS):
            return can.Message(
                timestamp=time_s,
                arbitration_id=int(number, 16),
                is_extended_id=extended,
                is_remote_frame=remote,
                dlc=length,
                data=None if remote else bytes.fromhex(digits[:shown].decode()),
            )
    raise ValueError(f"slcan: {line[:MAX_LINE_BYTES]!r} is no frame")


TICK_S = 1e-6
"""Least time from one frame to the next: stamps ascend."""

CLOCK_SET_BACK_S = 0.1

_END = b"\r"
_BELL = b"\a"


class SlcanBus(slcanBus):
    """python-can's bus with another way of receiving; it opens, sends and closes as that does."""

    def __init__(self, channel: str, **options: Any) -> None:
        """`options` are those of python-can's `slcanBus`."""
        self._begun = b""
        self._lines: deque[tuple[bytes, float]] = deque()
        self._read_s = self._last_s = 0.0
        super().__init__(channel, **options)

    def flush(self) -> None:
        """Forget what was received but not taken."""
        self._begun = b""
        self._lines.clear()
        super().flush()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """One frame, or None when there was none in time; python-can's point to extend.

        Raises:
            ValueError: a line that begins as a frame and is none.
            can.CanOperationError: the adapter is gone.
        """
        if not self._lines:
            self._read_lines(timeout)
        while self._lines:
            line, time_s = self._lines.popleft()
            if line[:1] in FRAME_COMMANDS:
                return line_frame(line, time_s), False
        return None, False

    def _read_lines(self, timeout: float | None) -> None:
        port = self.serialPortOrig
        with error_check("Could not read from serial device"):
            if port.timeout != timeout:
                port.timeout = timeout
            waiting = port.in_waiting
            data = port.read(max(1, waiting))
            data += port.read(port.in_waiting)
        now_s = time.time()
        since_s = self._read_s if waiting and 0.0 < self._read_s < now_s else now_s
        self._read_s = now_s
        *lines, rest = (self._begun + data.replace(_BELL, _END)).split(_END)
        if len(rest) > MAX_LINE_BYTES:
            lines.append(rest)
            rest = b""
        self._begun = rest
        self._stamp([line for line in lines if line], since_s, now_s)

    def _stamp(self, lines: list[bytes], since_s: float, now_s: float) -> None:
        """Spread lines over a stretch of time."""
        if self._last_s > now_s + CLOCK_SET_BACK_S:
            self._last_s = 0.0
        for number, line in enumerate(lines, start=1):
            time_s = since_s + (now_s - since_s) * number / len(lines)
            self._last_s = max(time_s, self._last_s + TICK_S)
            self._lines.append((line, self._last_s))


INTERFACES = ("socketcan", "slcan", "pcan", "kvaser", "virtual", "udp_multicast")
"""Those that are tried or documented here; python-can's others may well work."""


class CanInterfaceError(CableSenseError):
    """A CAN interface that cannot be opened: names it, why, and what to look at."""


@dataclass(frozen=True)
class CanInterface:
    """One interface.

    Attributes:
        interface: python-can's name of the kind of adapter.
        channel: `can0`, `/dev/ttyACM0`, `PCAN_USBBUS1`, …: what that kind calls its channels.
        bitrate_bit_s: of the bus; 0 where the system sets it (SocketCAN) or there is none.
    """

    interface: str
    channel: str
    bitrate_bit_s: int = 0

    def __post_init__(self) -> None:
        """Refuse what can never be opened.

        Raises:
            CanInterfaceError: the kind is unknown to python-can, or the channel is empty.
        """
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

        Other drivers put codes of their own there, which must not be read as such. `virtual`
        passes on whatever was put in, here by the emulator.
        """
        return self.interface in ("socketcan", "virtual")

    def open(self) -> can.BusABC:
        """Open it.

        Raises:
            CanInterfaceError: it is not there, busy, or its driver is not installed.
        """
        options: dict[str, Any] = {}
        if self.bitrate_bit_s:
            options["bitrate"] = self.bitrate_bit_s
        try:
            if self.interface == "slcan":
                bus = SlcanBus(self.channel, sleep_after_open=0.0, **options)
                bus.flush()  # what came before would be taken for new
                return bus
            return can.Bus(
                channel=self.channel, interface=self.interface, ignore_config=True, **options
            )
        except Exception as error:  # each adapter's driver raises errors of its own
            reason = " ".join(str(error).split())[:300] or type(error).__name__
            raise CanInterfaceError(f"{self.name} cannot be opened ({reason})") from error


NMT_ID = 0x000
START_REMOTE_NODE = 0x01
HEARTBEAT_ID = 0x700
BOOT_UP = b"\x00"


def start_frames(nodes: Sequence[int]) -> list[can.Message]:
    """One NMT start for each node, numbers 1 to 127."""
    return [
        can.Message(arbitration_id=NMT_ID, is_extended_id=False, data=[START_REMOTE_NODE, node])
        for node in nodes
    ]


def booted_node(frame: can.Message, nodes: Sequence[int]) -> int | None:
    """Which of the nodes says by this frame that it has just got power, if it is such a frame.

    It then waits in the state pre-operational, and must be started again.
    """
    node = frame.arbitration_id - HEARTBEAT_ID
    plain = not (frame.is_extended_id or frame.is_remote_frame or frame.is_error_frame)
    if plain and node in nodes and bytes(frame.data) == BOOT_UP:
        return node
    return None
