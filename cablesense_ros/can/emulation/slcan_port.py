"""A pseudo-terminal that poses as a serial CAN adapter (slcan, after Lawicel's CAN232 manual).

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
import tty
from collections import deque
from collections.abc import Sequence
from pathlib import Path

import can

from cablesense_msgs_py.errors import CableSenseError
from cablesense_ros.can.slcan_lines import (
    FRAME_COMMANDS,
    MAX_LINE_BYTES,
    frame_line,
    line_frame,
)

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
