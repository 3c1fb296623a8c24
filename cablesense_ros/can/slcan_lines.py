"""Frames as lines of the slcan protocol, and back (after Lawicel's CAN232 manual).

`t1234AABBCCDD` is id 123h with four bytes, `T` has an id of eight digits, `r` and `R` are remote
frames; the carriage return between lines is not part of them.
"""

from __future__ import annotations

import re

import can

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
