"""Serial CAN adapters, read in bulk: python-can's `slcan` reads byte by byte.

At a thousand cycles of four frames a second the driver takes some 0.3 of a core instead of 0.7.

The protocol's lines bear no time, so a frame gets that of its reading. Frames that had to wait are
spread over the time since the reading before, in which they came: else all of a backlog would
bear one time, and nobody downstream could tell their order or their rate.
"""

from __future__ import annotations

import time
from collections import deque
from typing import Any

import can
from can.exceptions import error_check
from can.interfaces.slcan import slcanBus

from cablesense_ros.can.slcan_lines import FRAME_COMMANDS, MAX_LINE_BYTES, line_frame

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
