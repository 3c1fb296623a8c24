"""Where emulated frames go: any python-can bus, or a pseudo-terminal that poses as an adapter."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from typing import Protocol

import can

from cablesense_ros.can.emulation.emulated_amplifier import PlannedFrame


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
