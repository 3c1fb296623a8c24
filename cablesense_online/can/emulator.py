"""The amplifier emulator without ROS: cycles of frames played on a bus or a pseudo-terminal.

`Emulator` plays an emulated amplifier on a sink that can be unplugged and plugged in again;
`RecordingPlayer` gives the rows of a recording as they become due.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence

import can
from cantools.database.can import Database

from cablesense_base import Array
from cablesense_online.can.bus import FaultKind
from cablesense_online.can.channel_map import ChannelMap
from cablesense_online.can.emulated_amplifier import EmulatedAmplifier, PlannedFrame
from cablesense_online.can.slcan import SlcanPort

COMMAND_EVERY_S = 1.0
PAUSE_S = 0.5
"""Between the end of a recording and its next beginning."""


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
        """The frames that others have sent since the last call."""
        frames = []
        with contextlib.suppress(can.CanError):
            while (frame := self._bus.recv(0.0)) is not None:
                frames.append(frame)
        return frames

    def close(self) -> None:
        """Shut the bus down."""
        self._bus.shutdown()


FrameSink = BusSink | SlcanPort
"""A destination of frames; its `dropped` counts those not passed on."""


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
    """Plays tensions out as frames; shows a fault for as long as it is requested.

    Attributes:
        amplifier: what is emulated.
        cycles: played so far.
        fault: the present one as it was requested; empty for none.
    """

    def __init__(
        self, channel_map: ChannelMap, database: Database, open_sink: Callable[[], FrameSink]
    ) -> None:
        """`open_sink` is called now, and again after each loss of the interface.

        Raises:
            CableSenseError: what `open_sink` raises.
        """
        self._open_sink = open_sink
        self.amplifier = EmulatedAmplifier(channel_map, database)
        self._sink: FrameSink | None = None
        self.cycles = 0
        self.fault = ""
        self._plug_in()

    @property
    def dropped(self) -> int:
        """Frames that the sink did not pass on since it was opened."""
        return self._sink.dropped if self._sink is not None else 0

    def request(self, fault: str) -> None:
        """Show a fault (`missing_channel cable_5`) from now on; an empty text ends it.

        Raises:
            FaultRequestError: there is no such fault.
            CableSenseError: the interface cannot be opened again.
        """
        self.amplifier.request(fault)
        self.fault = fault.strip()
        present = self.amplifier.fault
        if present is not None and present.kind is FaultKind.INTERFACE_LOST:
            self.close()
        elif self._sink is None:
            self._plug_in()

    def cycle(self, tensions_n: Sequence[float]) -> None:
        """Play one cycle: (M,) tensions in the order of the map."""
        self.listen()
        planned = self.amplifier.cycle(tensions_n)
        if self._sink is not None:
            play(self._sink, planned)
        self.cycles += 1

    def listen(self) -> None:
        """Take frames that others sent, such as an NMT start."""
        if self._sink is not None:
            for frame in self._sink.received():
                self.amplifier.take(frame)

    def close(self) -> None:
        """Pull the interface; safe to call twice."""
        sink, self._sink = self._sink, None
        if sink is not None:
            sink.close()

    def _plug_in(self) -> None:
        self._sink = self._open_sink()
        self._sink.send(self.amplifier.power_up())


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
        self._command_s = 0.0
        self.ended = False

    def due(self, now_s: float) -> list[tuple[Array, Array | None]]:
        """The rows due since the last call: (M,) tensions, and at times their command.

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
            due = new or now_s - self._command_s >= COMMAND_EVERY_S
            self._command_s = now_s if due else self._command_s
            rows.append((self._tensions_n[row], command if due else None))
            self._row += 1
            if self._row == len(self._time_s):
                self._row = 0
                self._began_s += float(self._time_s[-1]) + PAUSE_S
                self.ended = not self._loop
        return rows
