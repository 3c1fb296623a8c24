"""The emulator without ROS: an amplifier on a sink that can be pulled and plugged in again."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from cantools.database.can import Database

from cablesense_ros.can.channel_map import ChannelMap
from cablesense_ros.can.emulation.emulated_amplifier import EmulatedAmplifier
from cablesense_ros.can.emulation.fault_request import parse_fault
from cablesense_ros.can.emulation.frame_sink import FrameSink, play
from cablesense_ros.can.fault import FaultKind


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
