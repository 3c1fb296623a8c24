"""From received frames to samples of tensions: everything between the interface and the node."""

from __future__ import annotations

import can
from cantools.database.can import Database

from cablesense_ros.can.bus_clock import BusClock
from cablesense_ros.can.bus_condition import BusWatch
from cablesense_ros.can.channel_map import ChannelMap
from cablesense_ros.can.fault import FaultKind
from cablesense_ros.can.fault_ledger import FaultLedger
from cablesense_ros.can.flood_watch import FloodWatch
from cablesense_ros.can.frame_decoder import FrameDecoder
from cablesense_ros.can.interface import CanInterface
from cablesense_ros.can.sample_assembler import Sample, SampleAssembler
from cablesense_ros.can.stuck_watch import StuckWatch

SCATTER_OF_READING_S = 0.1
"""Skew limit where frames bear the time of reading: any pause of the process would look late. The
order of the frames then bounds the skew, as no channel comes twice in a sample: to one cycle."""


class TensionReader:
    """Takes frames as they come; gives a sample only when all of it can be believed.

    Attributes:
        frames: taken so far, of any kind.
        samples: given so far.
        largest_skew_s: of the samples given since the reporter last set it to zero.
        bus: the condition of the bus.
    """

    def __init__(
        self,
        channel_map: ChannelMap,
        database: Database,
        interface: CanInterface,
        ledger: FaultLedger,
    ) -> None:
        """`interface` is where the frames come from; it is not opened here."""
        self._ledger = ledger
        self._names = channel_map.cable_names
        self._decoder = FrameDecoder(channel_map, database, ledger)
        skew_limit_s = channel_map.skew_limit_s
        if not interface.stamps_frames:
            skew_limit_s = max(skew_limit_s, SCATTER_OF_READING_S)
        self._assembler = SampleAssembler(
            self._names, skew_limit_s, self._decoder.counter_modulo, ledger
        )
        self._stuck = StuckWatch(len(self._names), channel_map.stuck)
        self._clock = BusClock()
        known_frames_s = self._decoder.frames_per_cycle / channel_map.cycle_time_s
        self._flood = FloodWatch(channel_map.flood_frames_s, known_frames_s, ledger)
        self.bus = BusWatch(interface.name, interface.classes_errors, ledger)
        self.frames = 0
        self.samples = 0
        self._stuck_samples = 0
        self._cycle_time_s = channel_map.cycle_time_s
        self._last_frame_s = 0.0
        self.largest_skew_s = 0.0

    @property
    def withheld(self) -> int:
        """Samples not given so far: not whole, late, or not to be believed."""
        return self._assembler.dropped + self._stuck_samples

    def take(self, frame: can.Message, now_s: float, monotonic_s: float) -> Sample | None:
        """Take a frame; give the sample that it completes, if every reading can be believed.

        Args:
            frame: as received.
            now_s: arrival by this machine's clock, s since the epoch.
            monotonic_s: arrival by the monotonic clock.
        """
        self.frames += 1
        self._last_frame_s = monotonic_s
        if frame.is_error_frame:
            self.bus.error_frame(frame.arbitration_id, bytes(frame.data))
            return None
        self.bus.data_frame()
        if not self._flood.admit(self._decoder.knows(frame), monotonic_s):
            return None
        decoded = self._decoder.decode(frame)
        if decoded is None:
            return None
        sample = self._assembler.take(decoded, self._clock.time_s(frame.timestamp, now_s))
        if sample is None or self._has_stuck(sample):
            return None
        self.samples += 1
        self.largest_skew_s = max(self.largest_skew_s, sample.skew_s)
        return sample

    def silence(self, monotonic_s: float) -> None:
        """No frame came for a while; after a whole cycle of it an open sample is given up."""
        if monotonic_s - self._last_frame_s > self._cycle_time_s:
            self._assembler.silence()

    def reopened(self) -> None:
        """The interface was opened again: clocks, counters and condition start anew."""
        self._clock.restart()
        self._assembler.restart()
        self._stuck.restart()
        self.bus.reopened()

    def _has_stuck(self, sample: Sample) -> bool:
        stuck = self._stuck.stuck(sample.tensions_n, sample.time_s)
        for channel in stuck:
            name = self._names[channel]
            self._ledger.note(
                FaultKind.STUCK_VALUE,
                name,
                f"{name} stands at {sample.tensions_n[channel]:g} N while the others move",
            )
        self._stuck_samples += bool(stuck)
        return bool(stuck)
