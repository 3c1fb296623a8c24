"""The adapter's end of CAN over a serial line: the slcan protocol (Lawicel's CAN232 manual).

A frame is a line: `t1234AABBCCDD` is id 123h with four bytes, `T` has an id of eight digits, `r`
and `R` are remote frames; lines end with a carriage return. The protocol has no error frames.
`SlcanPort` is a pseudo-terminal that any host opens like a USB adapter, python-can's `slcan`
interface for example.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import termios
import threading
import tty
from collections import deque
from collections.abc import Sequence
from pathlib import Path

import can

from cablesense_base import CableSenseError

FRAME_COMMANDS = b"tTrR"
MAX_LINE_BYTES = 64
"""More without an end is no line: the longest frame has 26 characters, and a stamp four."""
_STAMP_DIGITS = 4
_OK, _BELL = b"\r", b"\a"
_HEX = rb"[0-9A-Fa-f]"
_LINE = re.compile(rb"([tr])(%b{3})([0-8])(%b*)" % (_HEX, _HEX))
_LONG_LINE = re.compile(rb"([TR])(%b{8})([0-8])(%b*)" % (_HEX, _HEX))
_ANSWERS = {b"V": b"V1013", b"N": b"NCSEM", b"F": b"F00"}
"""Version, serial number, status flags."""
_RECEIVED_KEPT = 1000
_WAKE_S = 0.1


class SlcanPortError(CableSenseError):
    """A pseudo-terminal that cannot be had, or a link to it that cannot be made."""


def frame_line(frame: can.Message) -> bytes | None:
    """A frame as a line without its return; None for error and CAN FD frames."""
    if frame.is_error_frame or frame.is_fd:
        return None
    letter = "r" if frame.is_remote_frame else "t"
    if frame.is_extended_id:
        head = f"{letter.upper()}{frame.arbitration_id:08X}{frame.dlc:d}"
    else:
        head = f"{letter}{frame.arbitration_id:03X}{frame.dlc:d}"
    return (head if frame.is_remote_frame else head + bytes(frame.data).hex().upper()).encode()


def line_frame(line: bytes) -> can.Message:
    """The frame of a line without its return; a stamp of four digits at its end is ignored.

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
                arbitration_id=int(number, 16),
                is_extended_id=extended,
                is_remote_frame=remote,
                dlc=length,
                data=None if remote else bytes.fromhex(digits[:shown].decode()),
            )
    raise ValueError(f"slcan: {line[:MAX_LINE_BYTES]!r} is no frame")


class SlcanPort:
    """The adapter: a thread answers the host until `close`.

    Attributes:
        path: the path that the host opens: the link if one was asked for, else the terminal.
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
        self._received: deque[can.Message] = deque(maxlen=_RECEIVED_KEPT)
        self._unfinished = b""
        self._write_lock = threading.Lock()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._answer, name="slcan port", daemon=True)
        self._thread.start()

    def send(self, frames: Sequence[can.Message]) -> None:
        """Pass frames to the host; those that it cannot take are dropped and counted."""
        lines = [line + _OK for line in map(frame_line, frames) if line is not None]
        self.dropped += len(frames) - (self._pass(lines) if self.channel_open else 0)

    def received(self) -> list[can.Message]:
        """The frames that the host has sent since the last call."""
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
            data = self._unfinished + b"".join(lines)
            sent = 0
            with contextlib.suppress(OSError):  # it is full, or the host is gone
                while sent < len(data):
                    sent += os.write(self._master, data[sent:])
            left = len(data) - sent
            passed = len(lines)
            while passed and left >= len(lines[passed - 1]):
                passed -= 1
                left -= len(lines[passed])
            open_line = lines[passed - 1] if passed else self._unfinished
            self._unfinished = open_line[-left:] if left else b""
            return passed

    def _answer(self) -> None:
        buffer = b""
        while not self._ended.is_set():
            if not select.select([self._master], [], [], _WAKE_S)[0]:
                continue
            try:
                buffer += os.read(self._master, 4096)
            except OSError:
                continue
            *lines, rest = buffer.split(_OK)
            buffer = rest[:MAX_LINE_BYTES]
            for line in lines:
                self._pass([self._reply(line)])

    def _reply(self, line: bytes) -> bytes:
        """An adapter's answer to one command."""
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
            try:
                frame = line_frame(line)
            except ValueError:
                return _BELL
            if not self.channel_open:
                return _BELL
            self._received.append(frame)
            return (b"z" if command.islower() else b"Z") + _OK
        if command in _ANSWERS:
            return _ANSWERS[command] + _OK
        return _OK if command in (b"", b"S", b"s", b"Z", b"M", b"m", b"Y") else _BELL
