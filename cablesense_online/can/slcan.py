"""The adapter's end of CAN over a serial line: the slcan protocol (Lawicel's CAN232 manual).

A frame is a line: `t1234AABBCCDD` is id 123h with four bytes, `T` has an id of eight digits, `r`
and `R` are remote frames. Lines end with a carriage return. The protocol has no error frames.
"""

from __future__ import annotations

import contextlib
import os
import re
import tty
from collections import deque
from pathlib import Path

import can

from cablesense_base import CableSenseError

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
        letter, data = ("R" if frame.is_extended_id else "r"), ""
    return f"{letter}{frame.arbitration_id:0{digits}X}{frame.dlc:d}{data}".encode()


def line_frame(line: bytes) -> can.Message:
    """The frame of a line without its return.

    Raises:
        ValueError: the line is no frame.
    """
    found = _LINE.fullmatch(line)
    if found is None:
        raise ValueError(f"slcan: {line[:_LONGEST_LINE]!r} is no frame")
    standard, extended, length, data = found.groups()
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
        self._from_host = self._unfinished = b""
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
        self._is_shutdown, self.channel_open = True, False
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
