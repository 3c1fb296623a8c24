"""From received frames to samples of tensions: decoded, assembled, and withheld where in doubt.

`TensionReader` passes each frame by the limit on rates, the decoder, the bus clock and the
assembler, and a whole sample by the search for stuck channels.
"""

from __future__ import annotations

import can
import numpy as np
from cantools.database.can import Database

from cablesense_base import Array
from cablesense_online.can.bus import (
    BusClock,
    BusCondition,
    BusState,
    CanInterface,
    FaultKind,
    FaultLedger,
)
from cablesense_online.can.channel_map import ChannelMap, StuckLimits
from cablesense_online.can.decoder import FrameDecoder, Sample, SampleAssembler

SCATTER_OF_READING_S = 0.1
"""Skew limit where frames bear the time of reading: any pause of the process would look late. The
order of the frames then bounds the skew, as no channel comes twice in a sample: to one cycle."""
KNOWN_EXCESS = 2.0
"""Frames of the map may come at this many times their rate; what exceeds it is dropped."""
ALLOWANCE_S = 0.5
"""So long a burst may last before it counts: a process that was held up reads its backlog in one
go, and loses none of it."""


class TensionReader:
    """Takes frames as they come; gives a sample only when all of it is valid.

    Attributes:
        frames: taken so far, of any kind.
        samples: given so far.
        largest_skew_s: of the samples given since the reporter last set it to zero.
        bus: the error state of the bus.
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
        self._stuck = StuckDetector(len(self._names), channel_map.stuck)
        self._clock = BusClock()
        known_frames_s = self._decoder.frames_per_cycle / channel_map.cycle_time_s
        self._all = TokenBucket(channel_map.flood_frames_s)
        self._known = TokenBucket(KNOWN_EXCESS * known_frames_s)
        self.bus = BusState(interface.name, interface.classes_errors, ledger)
        self.frames = 0
        self.samples = 0
        self._stuck_samples = 0
        self._cycle_time_s = channel_map.cycle_time_s
        self._last_frame_s = 0.0
        self.largest_skew_s = 0.0

    @property
    def withheld(self) -> int:
        """Samples not given so far: not whole, late, or not valid."""
        return self._assembler.dropped + self._stuck_samples

    def take(self, frame: can.Message, now_s: float, monotonic_s: float) -> Sample | None:
        """Take a frame; give the sample that it completes, if every reading is valid.

        `now_s` is its arrival, s since the epoch, `monotonic_s` that by the monotonic clock.
        """
        self.frames += 1
        self._last_frame_s = monotonic_s
        if frame.is_error_frame:
            self.bus.error_frame(frame.arbitration_id, bytes(frame.data))
            return None
        self.bus.data_frame()
        decoded = self._decoder.decode(frame) if self._admitted(frame, monotonic_s) else None
        if decoded is None:
            return None
        sample = self._assembler.take(decoded, self._clock.time_s(frame.timestamp, now_s))
        if sample is None:
            return None
        stuck = self._stuck.stuck(sample.tensions_n, sample.time_s)
        if stuck:
            for channel in stuck:
                name = self._names[channel]
                detail = f"{name} stands at {sample.tensions_n[channel]:g} N while the others move"
                self._ledger.note(FaultKind.STUCK_VALUE, name, detail)
            self._stuck_samples += 1
            return None
        self.samples += 1
        self.largest_skew_s = max(self.largest_skew_s, sample.skew_s)
        return sample

    def _admitted(self, frame: can.Message, now_s: float) -> bool:
        """Limit rates.

        Unknown frames cost little and pass at any rate; once all frames together exceed the limit
        this is noted. Frames of the map beyond twice their rate come from a babbling node; they
        are dropped, so that samples are never given at more than that rate.
        """
        if not self._all.take(now_s):
            detail = f"more than {self._all.rate:g} frames a second for {ALLOWANCE_S:g} s"
            self._ledger.note(FaultKind.FLOODED, "bus", detail)
        if not self._decoder.knows(frame) or self._known.take(now_s):
            return True
        detail = f"more than {self._known.rate:g} frames of the map a second"
        detail += f" for {ALLOWANCE_S:g} s; the excess is dropped"
        self._ledger.note(FaultKind.FLOODED, "amplifier", detail)
        return False

    def silence(self, monotonic_s: float) -> None:
        """No frame came for a while; after a whole cycle of it an open sample is given up."""
        if monotonic_s - self._last_frame_s > self._cycle_time_s:
            self._assembler.close()

    def reopened(self) -> None:
        """The interface was opened again: clocks, counters and error state start anew."""
        self._clock.restart()
        self._assembler.restart()
        self._stuck.restart()
        self.bus.condition = BusCondition.ACTIVE


class TokenBucket:
    """`rate` tokens a second, at most `ALLOWANCE_S` of them in store."""

    def __init__(self, rate: float) -> None:
        self.rate = rate
        self._most = max(1.0, rate * ALLOWANCE_S)
        self._tokens = self._most
        self._last_s: float | None = None

    def take(self, now_s: float) -> bool:
        """Take a token at a monotonic time; gives whether there was one."""
        if self._last_s is not None:
            self._tokens = min(self._most, self._tokens + (now_s - self._last_s) * self.rate)
        self._last_s = now_s
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True


class StuckDetector:
    """Finds channels that stand still while the others move.

    Readings of an arm in static equilibrium may well stay the same to the last bit, as noise can
    be smaller than the converter's step: that alone is no fault. Standing still for `after_s`
    while half of the other channels have moved by more than `others_moved_n` is. A channel once
    found stuck stays so until its reading changes.
    """

    def __init__(self, channel_count: int, limits: StuckLimits) -> None:
        self._limits = limits
        self._last_n: Array = np.full(channel_count, np.nan)
        self._since_s = np.zeros(channel_count)
        self._then_n = np.zeros((channel_count, channel_count))
        self._stuck = np.zeros(channel_count, dtype=bool)
        self._needed = max(1, -(-(channel_count - 1) // 2))

    def stuck(self, tensions_n: Array, time_s: float) -> tuple[int, ...]:
        """Positions of the channels that are stuck in a sample (M,); times ascend."""
        changed = tensions_n != self._last_n
        self._last_n = tensions_n.copy()
        self._since_s[changed] = time_s
        self._then_n[changed] = tensions_n
        self._stuck[changed] = False
        still = time_s - self._since_s >= self._limits.after_s
        if still.any():
            moved = np.abs(tensions_n - self._then_n[still]) > self._limits.others_moved_n
            self._stuck[still] |= moved.sum(axis=1) >= self._needed
        if not self._stuck.any():
            return ()
        return tuple(np.flatnonzero(self._stuck).tolist())

    def restart(self) -> None:
        """Begin anew, after a time without samples."""
        self._last_n = np.full_like(self._last_n, np.nan)
        self._stuck[:] = False
