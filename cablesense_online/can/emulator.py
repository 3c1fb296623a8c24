"""The emulator without ROS: an amplifier on a sink that can be pulled and plugged in again.

Where emulated frames go: any python-can bus, or a pseudo-terminal that poses as an adapter.

A recording in its own time: which row is due, and which command it came under.

A pseudo-terminal that poses as a serial CAN adapter (slcan, after Lawicel's CAN232 manual).

Whoever opens it, python-can's `slcan` interface for one, talks to it as to a USB adapter. The
protocol has no error frames and no timestamps that python-can would ask for, and a line is some
22 characters a frame; that is its limit, not the bus's.
"""

from __future__ import annotations

import contextlib
import os
import select
import termios
import threading
import time
import tty
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

import can
from cantools.database.can import Database

from cablesense_base.arrays import Array
from cablesense_base.errors import CableSenseError
from cablesense_online.can.bus import FRAME_COMMANDS, MAX_LINE_BYTES, frame_line, line_frame
from cablesense_online.can.channel_map import ChannelMap
from cablesense_online.can.emulated_amplifier import EmulatedAmplifier, PlannedFrame, parse_fault
from cablesense_online.can.faults import FaultKind


class FrameSink(Protocol):
    """What frames can be played on; `dropped` counts those that it did not pass on."""

    dropped: int

    def send(self, frames: Sequence[can.Message]) -> None:
        """Send frames in their order, at once."""

    def received(self) -> list[can.Message]:
        """What others have sent since this was last asked."""

    def close(self) -> None:
        """Let go of it."""


class BusSink:
    """A python-can bus as a sink.

    Attributes:
        dropped: frames that the bus did not take.
    """

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self.dropped = 0

    def send(self, frames: Sequence[can.Message]) -> None:
        """Send frames; a full transmit queue or a bus that is off drops them, counted."""
        for frame in frames:
            try:
                self._bus.send(frame)
            except can.CanError:
                self.dropped += 1

    def received(self) -> list[can.Message]:
        """What others have sent since this was last asked."""
        frames = []
        with contextlib.suppress(can.CanError):
            while (frame := self._bus.recv(0.0)) is not None:
                frames.append(frame)
        return frames

    def close(self) -> None:
        """Shut the bus down."""
        self._bus.shutdown()


def play(
    sink: FrameSink, planned: Sequence[PlannedFrame], sleep: Callable[[float], None] = time.sleep
) -> None:
    """Send planned frames, those without a wait between them together."""
    together: list[can.Message] = []
    for one in planned:
        if one.wait_s > 0.0:
            sink.send(together)
            together = []
            sleep(one.wait_s)
        together.append(one.frame)
    if together:
        sink.send(together)


class Emulator:
    """Plays tensions out as frames; shows a fault for as long as it is asked to.

    Attributes:
        cycles: played so far.
        fault: the present one as it was asked for; empty for none.
    """

    def __init__(
        self, channel_map: ChannelMap, database: Database, open_sink: Callable[[], FrameSink]
    ) -> None:
        """`open_sink` is called now, and again after each loss of the interface.

        Raises:
            CableSenseError: what `open_sink` raises.
        """
        self._map = channel_map
        self._open_sink = open_sink
        self._amplifier = EmulatedAmplifier(channel_map, database)
        self._sink: FrameSink | None = None
        self.cycles = 0
        self.fault = ""
        self._plug_in()

    @property
    def dropped(self) -> int:
        """Frames that the sink did not pass on since it was opened."""
        return self._sink.dropped if self._sink is not None else 0

    def check(self, fault: str) -> None:
        """Whether a fault can be asked for; changes nothing.

        Raises:
            FaultRequestError: it cannot.
        """
        self._amplifier.check(parse_fault(fault, self._map))

    def ask(self, fault: str) -> None:
        """Show a fault (`missing_channel cable_5`) from now on; an empty text ends it.

        Raises:
            FaultRequestError: there is no such fault.
            CableSenseError: the interface cannot be opened again.
        """
        asked = parse_fault(fault, self._map)
        self._amplifier.ask(asked)
        self.fault = fault.strip()
        pulled = asked is not None and asked.kind is FaultKind.INTERFACE_LOST
        if pulled:
            self.close()
        elif self._sink is None:
            self._plug_in()

    def cycle(self, tensions_n: Sequence[float]) -> None:
        """Play one cycle: (M,) tensions in the order of the map."""
        self.listen()
        planned = self._amplifier.cycle(tensions_n)
        if self._sink is not None:
            play(self._sink, planned)
        self.cycles += 1

    def listen(self) -> None:
        """Take what others sent, such as an NMT start."""
        if self._sink is not None:
            for frame in self._sink.received():
                self._amplifier.take(frame)

    def close(self) -> None:
        """Pull the interface; safe to call twice."""
        sink, self._sink = self._sink, None
        if sink is not None:
            sink.close()

    def _plug_in(self) -> None:
        self._sink = self._open_sink()
        self._sink.send(self._amplifier.power_up())


COMMAND_EVERY_S = 1.0

PAUSE_S = 0.5
"""Between the end of a recording and its next beginning."""


class RecordingPlayer:
    """Gives rows as they become due; times are of one monotonic clock, s.

    Attributes:
        ended: whether the last row was given, and there is no next time.
    """

    def __init__(self, time_s: Array, tensions_n: Array, command_rad: Array, loop: bool) -> None:
        """R rows: `time_s` (R,) ascending, `tensions_n` (R, M), `command_rad` (R, 2N)."""
        self._time_s = time_s - time_s[0]
        self._tensions_n = tensions_n
        self._command_rad = command_rad
        self._loop = loop
        self._row = 0
        self._began_s: float | None = None
        self._told_s = 0.0
        self.ended = False

    def due(self, now_s: float) -> list[tuple[Array, Array | None]]:
        """The rows due since this was last asked: (M,) tensions, and at times their command.

        The command (2N,) comes with the first row of every turn, wherever it changes, and once
        more every `COMMAND_EVERY_S`, for an estimator that was started later.
        """
        if self._began_s is None:
            self._began_s = now_s
        rows = []
        while not self.ended and self._began_s + self._time_s[self._row] <= now_s:
            row = self._row
            command = self._command_rad[row]
            new = row == 0 or (command != self._command_rad[row - 1]).any()
            told = new or now_s - self._told_s >= COMMAND_EVERY_S
            self._told_s = now_s if told else self._told_s
            rows.append((self._tensions_n[row], command if told else None))
            self._row += 1
            if self._row == len(self._time_s):
                self._row = 0
                self._began_s += float(self._time_s[-1]) + PAUSE_S
                self.ended = not self._loop
        return rows


VERSION, SERIAL_NUMBER, STATUS_FLAGS = b"V1013", b"NCSEM", b"F00"
RECEIVED_KEPT = 1000
_OK, _BELL = b"\r", b"\a"
_WAKE_S = 0.1


class SlcanPortError(CableSenseError):
    """A pseudo-terminal that cannot be had, or a link to it that cannot be made."""


class SlcanPort:
    """The adapter's side. A thread answers the host until `close`.

    Attributes:
        path: what the host opens: the link if one was asked for, else the terminal itself.
        channel_open: whether the host has opened the CAN channel (`O` or `L`).
        dropped: frames not passed on: channel shut, host too slow, or not sendable over slcan.
    """

    def __init__(self, link: str = "") -> None:
        """`link` is a path to put a symbolic link at, so that the port has a name that stays.

        Raises:
            SlcanPortError: no terminal left, or something else lies at `link`.
        """
        try:
            self._master, self._slave = os.openpty()
        except OSError as error:
            raise SlcanPortError(f"no pseudo-terminal can be had ({error})") from error
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._terminal = os.ttyname(self._slave)
        self.path = self._linked(link) if link else self._terminal
        self.channel_open = False
        self.dropped = 0
        self._received: deque[can.Message] = deque(maxlen=RECEIVED_KEPT)
        self._unfinished = b""
        self._write_lock = threading.Lock()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._answer, name="slcan port", daemon=True)
        self._thread.start()

    def send(self, frames: Sequence[can.Message]) -> None:
        """Pass frames to the host; those that it cannot take are dropped and counted."""
        lines = [line + _OK for line in map(frame_line, frames) if line is not None]
        self.dropped += len(frames) - len(lines)
        self.dropped += len(lines) - (self._pass(lines) if self.channel_open else 0)

    def received(self) -> list[can.Message]:
        """The frames that the host has sent since this was last asked."""
        frames = []
        with contextlib.suppress(IndexError):
            while True:
                frames.append(self._received.popleft())
        return frames

    def close(self) -> None:
        """Pull the adapter: the host's reads fail from now on; safe to call twice."""
        if self._ended.is_set():
            return
        self._ended.set()
        self._thread.join(timeout=2.0)
        with contextlib.suppress(OSError):
            if str(Path(self.path).readlink()) == self._terminal:  # and no later port's
                Path(self.path).unlink()
        with self._write_lock:
            self.channel_open = False
            os.close(self._slave)
            os.close(self._master)

    def _linked(self, link: str) -> str:
        """Put the link there; one of a port that was killed is replaced, nothing else is."""
        path = Path(link)
        try:
            if path.is_symlink() and path.readlink().is_relative_to(Path(self._terminal).parent):
                path.unlink()
            path.symlink_to(self._terminal)
        except OSError as error:
            os.close(self._slave)
            os.close(self._master)
            raise SlcanPortError(
                f"{link}: no link to {self._terminal} can be made there ({error.strerror}); give "
                "a path that is free, in a folder that exists"
            ) from error
        return link

    def _pass(self, lines: Sequence[bytes]) -> int:
        """Pass lines to the host as far as it takes them at once; how many went.

        The terminal takes bytes, not lines: what it leaves of one goes before anything else the
        next time, so that no line is cut and none is mixed with another.
        """
        with self._write_lock:
            if self._ended.is_set():
                return 0
            left = self._write(self._unfinished + b"".join(lines))
            passed = len(lines)
            while passed and left >= len(lines[passed - 1]):
                passed -= 1
                left -= len(lines[passed])
            if passed:
                self._unfinished = lines[passed - 1][-left:] if left else b""
            else:
                self._unfinished = self._unfinished[-left:] if left else b""
            return passed

    def _write(self, data: bytes) -> int:
        """Write what the terminal takes; how many bytes it left."""
        sent = 0
        with contextlib.suppress(OSError):  # it is full, or the host is gone
            while sent < len(data):
                sent += os.write(self._master, data[sent:])
        return len(data) - sent

    def _answer(self) -> None:
        buffer = bytearray()
        while not self._ended.is_set():
            if not select.select([self._master], [], [], _WAKE_S)[0]:
                continue
            try:
                buffer += os.read(self._master, 4096)
            except OSError:
                continue
            *lines, rest = bytes(buffer).split(b"\r")
            buffer = bytearray(rest[:MAX_LINE_BYTES])
            for line in lines:
                self._pass([self._reply(line)])

    def _reply(self, line: bytes) -> bytes:
        """What an adapter answers to one command."""
        command = line[:1]
        if command in (b"O", b"L"):
            if not self.channel_open:
                # what the last host left unread is not for the next one
                with self._write_lock:
                    termios.tcflush(self._slave, termios.TCIFLUSH)
                    self._unfinished = b""
            self.channel_open = True
            return _OK
        if command == b"C":
            self.channel_open = False
            return _OK
        if command and command in FRAME_COMMANDS:
            return self._take(line)
        answers = {b"V": VERSION, b"N": SERIAL_NUMBER, b"F": STATUS_FLAGS}
        if command in answers:
            return answers[command] + _OK
        return _OK if command in (b"", b"S", b"s", b"Z", b"M", b"m", b"Y") else _BELL

    def _take(self, line: bytes) -> bytes:
        """A frame that the host sends."""
        if not self.channel_open:
            return _BELL
        try:
            self._received.append(line_frame(line))
        except ValueError:
            return _BELL
        return (b"z" if line[:1].islower() else b"Z") + _OK
