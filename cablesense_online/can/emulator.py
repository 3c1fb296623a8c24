"""Emulated amplifiers: tensions played as CAN frames by a channel map, with faults on request.

`SlcanPort` is the adapter's end of CAN over a serial line (slcan, Lawicel's CAN232 manual), on a
pseudo-terminal. A frame is a line: `t1234AABBCCDD` is id 123h with four bytes, `T` has an id of
eight digits, `r` and `R` are remote frames. Lines end with a carriage return. The protocol has no
error frames.
"""

from __future__ import annotations

import contextlib
import os
import re
import tty
from collections import deque
from collections.abc import Callable, Sequence
from math import isfinite
from pathlib import Path

import can
from cantools.database.can import Database, Message, Signal

from cablesense_base import CableSenseError
from cablesense_online.can.bus import (
    BUS_ERROR_CLASS,
    BUS_OFF_CLASS,
    HEARTBEAT_ID,
    NMT_ID,
    RESTARTED_CLASS,
    START_REMOTE_NODE,
)
from cablesense_online.can.channel_map import ChannelMap, ChannelMapError

FAULTS_OF_CABLE = ("missing_channel", "wrong_length", "over_range", "stuck_value")
FAULTS_OF_BUS = (
    *("counter_gap", "unknown_id", "error_frame"),
    *("bus_off", "silent_bus", "interface_lost"),
)
_GAP_CYCLES = 3
"""Cycles in turn that are missing under the fault `counter_gap`."""
_CYCLES_PER_GAP = 50
"""Cycles from one such gap to the next."""
_NODE_BITS = 0x7F
"""Of a CAN identifier: the node's number (CiA 301)."""


class FaultRequestError(CableSenseError):
    """A fault that cannot be emulated: lists those that can."""


class Emulator:
    """Plays tensions as frames: the counter's first, then the others by ascending id.

    Amplifiers of a map with `nmt_start_nodes` are silent until each node was started, as CANopen
    requires (CiA 301).

    Attributes:
        cycles: number of cycles played.
        dropped: number of frames that the bus did not take.
        fault: as it was requested; empty for none.
    """

    def __init__(
        self, channel_map: ChannelMap, database: Database, open_bus: Callable[[], can.BusABC]
    ) -> None:
        """`open_bus` is called now, and again after each loss of the interface.

        `channel_map` must fit `database` (`channel_map.check_fit`).
        """
        self._map = channel_map
        self._open_bus = open_bus
        opens = channel_map.counter.message if channel_map.counter else None
        self._messages = sorted(
            map(database.get_message_by_name, channel_map.message_names),
            key=lambda message: (message.name != opens, message.frame_id),
        )
        described = {message.frame_id for message in database.messages}
        self._unknown_id = next(n for n in range(0x7FF, -1, -1) if n not in described)
        self._count = 0
        self.cycles = 0
        self.dropped = 0
        self._frozen_n: float | None = None
        self._off = False
        self._started: set[int] = set()
        self.fault = ""
        self._bus: can.BusABC | None = None
        self._plug_in()

    def check_fault(self, text: str) -> tuple[str, str]:
        """Kind and cable of the fault that a text requests (`missing_channel cable_5`).

        The cable is empty for faults of the whole bus, and both are for an empty text.

        Raises:
            FaultRequestError: an unknown fault or cable, or a fault that this map cannot have.
        """
        kind, *cables = text.split() or [""]
        names = self._map.cable_names
        if kind in FAULTS_OF_CABLE:
            if len(cables) != 1 or cables[0] not in names:
                raise FaultRequestError(
                    f"{kind} needs one cable of {names[0]} … {names[-1]}, as '{kind} {names[0]}'"
                )
            return kind, cables[0]
        if kind and kind not in FAULTS_OF_BUS:
            known = ", ".join((*FAULTS_OF_CABLE, *FAULTS_OF_BUS))
            raise FaultRequestError(f"unknown fault {kind[:40]!r}; there are {known}")
        if cables:
            raise FaultRequestError(f"{kind} concerns the whole bus; leave the cable out")
        if kind == "counter_gap" and self._map.counter is None:
            raise FaultRequestError(f"map {self._map.name} has no cycle counter")
        return kind, ""

    def request(self, fault: str) -> None:
        """Start a fault with the next cycle; an empty text ends it."""
        kind, _ = self.check_fault(fault)
        self.fault = fault.strip()
        self._frozen_n = None
        if kind == "interface_lost":
            self.close()
        elif self._bus is None:
            self._plug_in()

    def cycle(self, tensions_n: Sequence[float]) -> None:
        """Play one cycle: (M,) tensions in the order of the map."""
        self.listen()
        self._send(self.frames(tensions_n))
        self.cycles += 1

    def listen(self) -> None:
        """Take frames that others sent; only an NMT start has an effect."""
        with contextlib.suppress(can.CanError):
            while self._bus is not None and (frame := self._bus.recv(0.0)) is not None:
                if frame.arbitration_id != NMT_ID or len(frame.data) != 2 or frame.is_error_frame:
                    continue
                command, node = frame.data
                if command == START_REMOTE_NODE:
                    nodes = set(self._map.nmt_start_nodes)
                    self._started |= nodes if node == 0 else nodes & {node}

    def close(self) -> None:
        """Pull the interface; safe to call twice."""
        bus = self._bus
        self._bus = None
        if bus is not None:
            bus.shutdown()

    def frames(self, tensions_n: Sequence[float]) -> list[can.Message]:
        """The frames of the next cycle, with the present fault; (M,) in the order of the map.

        A tension beyond the range of a signal's bits is sent as the last value in it, as real
        converters do.

        Raises:
            ChannelMapError: a tension is not finite and its signal is a whole number.
        """
        kind, cable = self.check_fault(self.fault)
        self._count += 1
        was_off = self._off
        self._off = kind == "bus_off"
        if self._off:
            return [] if was_off else [_frame(BUS_OFF_CLASS, is_error_frame=True)]
        first = [_frame(RESTARTED_CLASS, is_error_frame=True)] if was_off else []
        in_gap = kind == "counter_gap" and self._count % _CYCLES_PER_GAP < _GAP_CYCLES
        if in_gap or kind in ("silent_bus", "interface_lost"):
            return first
        values = dict(zip(self._map.cable_names, map(float, tensions_n), strict=True))
        if kind == "over_range":
            values[cable] = self._map.range_n[1] + 1.0
        elif kind == "stuck_value":
            self._frozen_n = values[cable] if self._frozen_n is None else self._frozen_n
            values[cable] = self._frozen_n
        faulty = self._map.channels[cable].message if cable else None
        for message in self._messages:
            if kind == "missing_channel" and message.name == faulty:
                continue
            node = message.frame_id & _NODE_BITS
            if self._map.nmt_start_nodes and node not in self._started:
                continue
            data = message.encode(self._raw_values(message, values), scaling=False, strict=False)
            if kind == "wrong_length" and message.name == faulty:
                data = data[:-1]
            first.append(_frame(message.frame_id, data, is_extended_id=message.is_extended_frame))
        if kind == "unknown_id":
            first.append(_frame(self._unknown_id))
        elif kind == "error_frame":
            first.append(_frame(BUS_ERROR_CLASS, is_error_frame=True))
        return first

    def _raw_values(self, message: Message, values: dict[str, float]) -> dict[str, float]:
        """The raw values of a message's signals; others than readings and counter are 0."""
        raw = {signal.name: 0.0 for signal in message.signals}
        for cable, channel in self._map.channels.items():
            if channel.message == message.name:
                signal = message.get_signal_by_name(channel.signal)
                raw[channel.signal] = _raw(signal, channel.value(values[cable]))
        counter = self._map.counter
        if counter is not None and counter.message == message.name:
            bits = message.get_signal_by_name(counter.signal).length
            raw[counter.signal] = self._count % (1 << bits)
        return raw

    def _plug_in(self) -> None:
        """Open the interface; CANopen nodes get power and send their boot-up messages."""
        self._bus = self._open_bus()
        self._started.clear()
        self._send([_frame(HEARTBEAT_ID + node, b"\x00") for node in self._map.nmt_start_nodes])

    def _send(self, frames: Sequence[can.Message]) -> None:
        """Send frames. A full transmit queue or a bus that is off drops them."""
        if (bus := self._bus) is None:
            return
        for frame in frames:
            try:
                bus.send(frame)
            except can.CanError:
                self.dropped += 1


def _raw(signal: Signal, value: float) -> float:
    scaled = (value - signal.offset) / signal.scale
    if signal.is_float:
        return float(scaled)
    if not isfinite(scaled):
        raise ChannelMapError(f"signal {signal.name} is a whole number and cannot carry {value}")
    lowest = -(1 << (signal.length - 1)) if signal.is_signed else 0
    highest = (1 << (signal.length - signal.is_signed)) - 1
    return max(lowest, min(highest, round(scaled)))


def _frame(number: int, data: bytes = bytes(8), **form: bool) -> can.Message:
    return can.Message(arbitration_id=number, data=data, **{"is_extended_id": False, **form})


_HEX = rb"[0-9A-Fa-f]"
_LINE = re.compile(rb"(?:[tr](%b{3})|[TR](%b{8}))([0-8])((?:%b%b)*)" % ((_HEX,) * 4))
_LONGEST_LINE = 64
"""A line without an end within this length is discarded; the longest frame has 26 characters."""


class SlcanPortError(CableSenseError):
    """A pseudo-terminal that cannot be opened, or a link to it that cannot be made."""


def frame_line(frame: can.Message) -> bytes | None:
    """A frame as a line without its return; none for error and CAN FD frames."""
    if frame.is_error_frame or frame.is_fd:
        return None
    letter, digits = ("T", 8) if frame.is_extended_id else ("t", 3)
    data = bytes(frame.data).hex().upper()
    if frame.is_remote_frame:
        letter = "R" if frame.is_extended_id else "r"
        data = ""
    return f"{letter}{frame.arbitration_id:0{digits}X}{frame.dlc:d}{data}".encode()


def line_frame(line: bytes) -> can.Message:
    """The frame of a line without its return.

    Raises:
        ValueError: the line is no frame.
    """
    match = _LINE.fullmatch(line)
    if match is None:
        raise ValueError(f"slcan: {line[:_LONGEST_LINE]!r} is no frame")
    standard, extended, length, data = match.groups()
    remote = line[:1] in b"rR"
    return can.Message(
        arbitration_id=int(standard or extended, 16),
        is_extended_id=standard is None,
        is_remote_frame=remote,
        dlc=int(length),
        data=None if remote else bytes.fromhex(data.decode()),
        check=True,
    )


class SlcanPort(can.BusABC):
    """An adapter on a pseudo-terminal, which any host opens like a USB adapter.

    It answers the host when its owner calls `recv`.

    Attributes:
        path: the path that the host opens: the link if one was asked for, else the terminal.
        channel_open: whether the host has opened the CAN channel (`O` or `L`).
    """

    def __init__(self, link: str = "") -> None:
        """`link` is the path of a symbolic link to make, so that the port has a constant name.

        Raises:
            SlcanPortError: no terminal is left, or something else is at `link`.
        """
        try:
            self._master, self._slave = os.openpty()
        except OSError as error:
            raise SlcanPortError(f"no pseudo-terminal can be opened ({error})") from error
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._terminal = os.ttyname(self._slave)
        self.path = link or self._terminal
        self.channel_open = False
        self._received: deque[can.Message] = deque(maxlen=1000)
        self._from_host = b""
        self._unfinished = b""
        if link:
            self._make_link(Path(link))
        super().__init__(channel=self.path)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Pass a frame to the host.

        Raises:
            CanOperationError: the channel is shut, the host reads too slowly, or slcan has no
                such frame.
        """
        line = frame_line(msg)
        if line is None or not self.channel_open or not self._write(line + b"\r"):
            raise can.CanOperationError(f"{self.path}: the host did not take a frame")

    def shutdown(self) -> None:
        """Pull the adapter: the host's reads fail from now on; safe to call twice."""
        if self._is_shutdown:
            return
        super().shutdown()
        with contextlib.suppress(OSError):
            if str(Path(self.path).readlink()) == self._terminal:  # not a later port's link
                Path(self.path).unlink()
        self._close()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._is_shutdown:
            self._serve()
        return (self._received.popleft() if self._received else None), True

    def _make_link(self, path: Path) -> None:
        """Make the link. A link of a port that was killed is replaced, nothing else."""
        try:
            if path.is_symlink() and path.readlink().is_relative_to(Path(self._terminal).parent):
                path.unlink()
            path.symlink_to(self._terminal)
        except OSError as error:
            self._close()
            raise SlcanPortError(
                f"{path}: no link to {self._terminal} can be made there ({error.strerror}); give "
                "a free path in an existing folder"
            ) from error

    def _close(self) -> None:
        self._is_shutdown = True
        self.channel_open = False
        os.close(self._slave)
        os.close(self._master)

    def _write(self, line: bytes) -> bool:
        """Whether the host takes a line. The rest of a cut line is sent before the next one."""
        data = self._unfinished + line
        sent = 0
        with contextlib.suppress(OSError):  # the terminal is full
            sent = os.write(self._master, data)
        taken = sent > len(self._unfinished)
        self._unfinished = data[sent:] if taken else self._unfinished[sent:]
        return taken

    def _serve(self) -> None:
        """Answer the commands that the host has sent."""
        with contextlib.suppress(OSError):  # nothing was sent
            self._from_host += os.read(self._master, 4096)
        *lines, rest = self._from_host.split(b"\r")
        self._from_host = rest[:_LONGEST_LINE]
        for line in lines:
            command = line[:1]
            if command in (b"O", b"L", b"C"):
                self.channel_open = command != b"C"
                self._unfinished = b""
            elif self.channel_open:
                with contextlib.suppress(ValueError):  # another command
                    self._received.append(line_frame(line))
            self._write(b"\r")
