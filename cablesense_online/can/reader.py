"""Samples of tensions from received frames: decoded, assembled, and withheld if in doubt.

`TensionReader` passes each frame to the decoder (cantools), the bus clock and the assembler, and
each whole sample to the search for stuck channels. A sample that is not whole, late or invalid is
dropped, never filled up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import NamedTuple

import can
import numpy as np
from cantools.database.can import Database, Message

from cablesense_base import Array
from cablesense_online.can.bus import (
    ERROR_ACTIVE,
    BusState,
    CanInterface,
    FaultKind,
    FaultLedger,
)
from cablesense_online.can.channel_map import Channel, ChannelMap, StuckLimits

SCATTER_OF_READING_S = 0.1
"""Skew limit for frames that have the time of reading: any pause of the process would look late.
No channel comes twice in a sample, so the order of frames limits the skew to one cycle."""
SAME_CLOCK_S = 0.05
"""Time stamps with a smaller lag come from this machine's clock, as SocketCAN's do."""
DRIFT = 200e-6
"""Upper limit of the relative drift of two quartz clocks."""
JUMP_S = 2.0
"""A larger sudden increase of the lag is a clock that was set, not a busy machine."""
CUT_SAMPLES, WIDER = 8, 2.0
"""Number of successive samples, each with a pause inside that is this many times the pause before
it, which show that samples begin in mid-cycle. Bus traffic delays single frames only."""


class Decoded(NamedTuple):
    """The content of one frame.

    Attributes:
        readings: (channel, N) pairs; the channel is its position in the map.
        valid: whether all readings are valid.
        counter: the number of the cycle that the frame opens, if it opens one.
    """

    readings: Sequence[tuple[int, float]] = ()
    valid: bool = True
    counter: int | None = None


class _Plan(NamedTuple):
    """A message of the map, its channels with position and cable, and its counter's signal."""

    message: Message
    channels: tuple[tuple[int, str, Channel], ...]
    counter: str | None


class FrameDecoder:
    """Decodes the frames of the map and notes faulty ones.

    Attributes:
        counter_modulo: the counter restarts at 0 when it would reach this; 0 without a counter.
    """

    def __init__(self, channel_map: ChannelMap, database: Database, ledger: FaultLedger) -> None:
        """`channel_map` must fit `database` (`channel_map.check_fit`)."""
        self._map, self._ledger = channel_map, ledger
        self._described = {(m.frame_id, m.is_extended_frame) for m in database.messages}
        self._plans: dict[tuple[int, bool], _Plan] = {}
        self.counter_modulo = 0
        numbered = [(n, *item) for n, item in enumerate(channel_map.channels.items())]
        for name in channel_map.message_names:
            message, counter = database.get_message_by_name(name), None
            if channel_map.counter and channel_map.counter.message == name:
                counter = channel_map.counter.signal
                self.counter_modulo = 1 << message.get_signal_by_name(counter).length
            channels = tuple(one for one in numbered if one[2].message == name)
            key = (message.frame_id, message.is_extended_frame)
            self._plans[key] = _Plan(message, channels, counter)

    def decode(self, frame: can.Message) -> Decoded | None:
        """A frame's content; none, with a noted fault, if the frame has another form or id.

        Other ids that the DBC file describes have no content and are no fault.
        """
        key = (frame.arbitration_id, frame.is_extended_id)
        plan = self._plans.get(key)
        if plan is None:
            if key not in self._described:
                self._ledger.note(FaultKind.UNKNOWN_ID, f"0x{frame.arbitration_id:X}")
            return None
        name, length = plan.message.name, plan.message.length
        if frame.is_remote_frame or frame.is_fd or len(frame.data) != length:
            kind = "remote" if frame.is_remote_frame else "CAN FD" if frame.is_fd else "data"
            detail = f"{name} came as a {kind} frame with {len(frame.data)} bytes"
            detail += f"; the DBC file describes a data frame with {length}"
            self._ledger.note(FaultKind.WRONG_LENGTH, name, detail)
            return None
        values = plan.message.decode(bytes(frame.data), decode_choices=False)
        return self._readings(plan, values)  # type: ignore[arg-type]  # no container, no choices

    def _readings(self, plan: _Plan, values: dict[str, float]) -> Decoded:
        low, high = self._map.range_n
        readings, valid = [], True
        for number, cable, channel in plan.channels:
            tension_n = channel.tension_n(values[channel.signal])
            status = int(values[channel.status]) if channel.status is not None else 0
            fault = (
                self._fault(tension_n, status) if status or not low < tension_n < high else None
            )
            if fault is not None:
                valid = False
                suffix = f", status 0x{status:02X}" if status else ""
                self._ledger.note(fault, cable, f"{cable} reads {tension_n:g} N{suffix}")
            readings.append((number, tension_n))
        counter = int(values[plan.counter]) if plan.counter is not None else None
        return Decoded(readings, valid, counter)

    def _fault(self, tension_n: float, status: int) -> FaultKind | None:
        (low, high), masks = self._map.range_n, self._map.status_masks
        if status & masks.over_range or (tension_n >= high and isfinite(tension_n)):
            return FaultKind.OVER_RANGE
        if status & masks.under_range or (tension_n <= low and isfinite(tension_n)):
            return FaultKind.UNDER_RANGE
        if status & masks.invalid:
            return FaultKind.INVALID_STATUS
        return None if isfinite(tension_n) else FaultKind.NOT_FINITE


@dataclass(frozen=True, slots=True)
class Sample:
    """One reading of every channel, all within the skew limit.

    Attributes:
        time_s: bus time of its first frame, because an amplifier measures before it sends.
        skew_s: bus time from the first to the last frame.
        tensions_n: (M,) in the order of the map.
    """

    time_s: float
    skew_s: float
    tensions_n: Array


class SampleAssembler:
    """Assembles samples.

    With a cycle counter, its frame opens a sample, and only frames until the next one belong to
    it. Without one, the first frame after a sample opens the next. A channel that comes a second
    time, or later than the skew limit, then ends an unfinished sample and opens another. After a
    lost frame, samples may begin in mid-cycle: frames then wait for the pause between two cycles.

    Attributes:
        dropped: number of samples dropped because they were late, not whole, or invalid.
    """

    def __init__(
        self,
        cable_names: Sequence[str],
        skew_limit_s: float,
        counter_modulo: int,
        ledger: FaultLedger,
    ) -> None:
        """`counter_modulo` is 0 for an amplifier without a counter."""
        self._names = tuple(cable_names)
        self._skew_limit_s = skew_limit_s
        self._modulo = counter_modulo
        self._ledger = ledger
        self._tensions_n = [0.0] * len(self._names)
        self._missing = set(range(len(self._names)))
        self._open_s: float | None = None
        self._last_count: int | None = None
        self._valid = True
        self._frame_s = -np.inf
        self._pause_before_s = self._widest_pause_s = self._awaited_pause_s = 0.0
        self._cut = 0
        self.dropped = 0

    def take(self, decoded: Decoded, time_s: float) -> Sample | None:
        """Add a frame with its bus time, and give the sample that it completes."""
        if decoded.counter is not None:
            self._open(time_s)
            self._valid = self._counts_on(decoded.counter)
        if not decoded.readings:
            return None
        channels = [channel for channel, _ in decoded.readings]
        pause_s, self._frame_s = time_s - self._frame_s, time_s
        if pause_s < self._awaited_pause_s:
            return None
        self._awaited_pause_s = 0.0
        if self._open_s is None:
            self._pause_before_s, self._widest_pause_s = pause_s, 0.0
        else:
            self._widest_pause_s = max(self._widest_pause_s, pause_s)
        if self._open_s is not None:
            late = abs(time_s - self._open_s) > self._skew_limit_s
            if late or not self._missing.issuperset(channels):
                self._note_late(channels, time_s - self._open_s, late)
                if self._modulo:
                    self._valid = False
                else:
                    self._open(time_s)
        elif self._modulo:
            return None  # the rest of a cycle whose counter did not come
        else:
            self._open(time_s)
        for channel, tension_n in decoded.readings:
            self._tensions_n[channel] = tension_n
            self._missing.discard(channel)
        self._valid = self._valid and decoded.valid
        opened_s = self._open_s
        if self._missing or opened_s is None:
            return None
        self._open_s = None
        if not self._valid or self._begins_in_mid_cycle():
            self.dropped += 1
            return None
        return Sample(opened_s, time_s - opened_s, np.array(self._tensions_n))

    def _open(self, time_s: float) -> None:
        """Open a sample. An unfinished one is dropped, and its missing channels are named."""
        if self._open_s is not None:
            for channel in sorted(self._missing):
                self._ledger.note(FaultKind.MISSING_CHANNEL, self._names[channel])
            self.dropped += 1
        self._open_s, self._valid = time_s, True
        self._missing = set(range(len(self._names)))

    def _begins_in_mid_cycle(self) -> bool:
        """Whether samples without a counter are cut; the next one then waits for the pause."""
        cut = not self._modulo and self._widest_pause_s > WIDER * self._pause_before_s
        self._cut = self._cut + 1 if cut else 0
        if self._cut < CUT_SAMPLES:
            return False
        self._cut, self._awaited_pause_s = 0, self._widest_pause_s / WIDER
        detail = (
            "samples held readings of two cycles; they begin at the pause between cycles again"
        )
        self._ledger.note(FaultKind.LATE_CHANNEL, "cycle", detail)
        return True

    def _note_late(self, channels: Sequence[int], after_s: float, late: bool) -> None:
        """Without a counter, a channel that comes twice belongs to the next sample."""
        for channel in channels:
            if self._modulo or (late and channel in self._missing):
                name = self._names[channel]
                detail = f"{name} came twice in one cycle, or {after_s * 1e3:.2f} ms after the "
                detail += f"first frame; the skew limit is {self._skew_limit_s * 1e3:g} ms"
                self._ledger.note(FaultKind.LATE_CHANNEL, name, detail)
                self._missing.discard(channel)  # named as late, not as missing too

    def _counts_on(self, count: int) -> bool:
        """Whether the counter moved; if it stands still, the amplifier repeats old values."""
        last, self._last_count = self._last_count, count
        steps = 1 if last is None else (count - last) % self._modulo
        detail = f"the cycle counter went from {last} to {count}: {steps - 1} cycles lost"
        if steps == 0:
            detail = f"the cycle counter stands still at {count}"
        if steps != 1:
            self._ledger.note(FaultKind.COUNTER_GAP, "cycle counter", detail)
        return steps > 0


class StuckDetector:
    """Finds channels that stand still while the others move.

    Noise can be smaller than the converter's step, so readings of an arm in static equilibrium
    may stay the same to the last bit. A channel is stuck if it stands still for `after_s` while
    half of the others move by more than `others_moved_n`. It stays so until its reading changes.
    """

    def __init__(self, channel_count: int, limits: StuckLimits) -> None:
        self._limits = limits
        self._last_n: Array = np.full(channel_count, np.nan)
        self._since_s = np.zeros(channel_count)
        self._then_n = np.zeros((channel_count, channel_count))
        self._stuck = np.zeros(channel_count, dtype=bool)
        self._needed = max(1, channel_count // 2)

    def stuck(self, tensions_n: Array, time_s: float) -> list[int]:
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
        return np.flatnonzero(self._stuck).tolist() if self._stuck.any() else []


class BusClock:
    """Converts bus time stamps to this machine's clock.

    Some adapters have their own clock, which starts when they do. The smallest lag of arrival
    behind the stamp is the distance of the clocks plus the shortest delay; it follows their
    drift. Frames without a usable stamp count from their arrival.
    """

    def __init__(self) -> None:
        self._lag_s: float | None = None
        self._last_now_s = 0.0

    def time_s(self, stamp_s: float, now_s: float) -> float:
        """Time of a frame from its stamp and its arrival `now_s`, s since the epoch."""
        if not isfinite(stamp_s) or stamp_s <= 0.0:
            return now_s
        lag_s, known_s = now_s - stamp_s, self._lag_s
        if known_s is not None and lag_s - known_s <= JUMP_S:
            lag_s = min(lag_s, known_s + DRIFT * max(0.0, now_s - self._last_now_s))
        self._lag_s, self._last_now_s = lag_s, now_s
        return stamp_s if 0.0 <= lag_s <= SAME_CLOCK_S else stamp_s + lag_s


class TensionReader:
    """Takes frames as they arrive, and gives a sample only if all of it is valid.

    Attributes:
        bus: the error state of the bus.
        frames: number of frames taken, of any kind.
        samples: number of samples given.
        largest_skew_s: of the samples given since the caller last set it to zero.
    """

    def __init__(
        self,
        channel_map: ChannelMap,
        database: Database,
        interface: CanInterface,
        ledger: FaultLedger,
    ) -> None:
        """`interface` is the source of the frames; it is not opened here."""
        self._map, self._ledger = channel_map, ledger
        self._decoder = FrameDecoder(channel_map, database, ledger)
        self._skew_limit_s = channel_map.skew_limit_s
        if not interface.stamps_frames:
            self._skew_limit_s = max(self._skew_limit_s, SCATTER_OF_READING_S)
        self.bus = BusState(interface, ledger)
        self.frames = self.samples = self._withheld = 0
        self.largest_skew_s = 0.0
        self._restart()

    @property
    def withheld(self) -> int:
        """Number of samples not given because they were not whole, late or invalid."""
        return self._withheld + self._assembler.dropped

    def take(self, frame: can.Message, now_s: float) -> Sample | None:
        """The sample that a frame completes, if any; `now_s` is its arrival, s since the epoch."""
        self.frames += 1
        if frame.is_error_frame:
            self.bus.error_frame(frame.arbitration_id, bytes(frame.data))
            return None
        self.bus.data_frame()
        decoded = self._decoder.decode(frame)
        if decoded is None:
            return None
        sample = self._assembler.take(decoded, self._clock.time_s(frame.timestamp, now_s))
        if sample is None:
            return None
        stuck = self._stuck.stuck(sample.tensions_n, sample.time_s)
        for channel in stuck:
            name = self._map.cable_names[channel]
            detail = f"{name} stands at {sample.tensions_n[channel]:g} N while the others move"
            self._ledger.note(FaultKind.STUCK_VALUE, name, detail)
        if stuck:
            self._withheld += 1
            return None
        self.samples += 1
        self.largest_skew_s = max(self.largest_skew_s, sample.skew_s)
        return sample

    def reopened(self) -> None:
        """Forget clock, counter, open sample and error state: the interface was opened again."""
        self._withheld += self._assembler.dropped
        self.bus.condition = ERROR_ACTIVE
        self._restart()

    def _restart(self) -> None:
        names = self._map.cable_names
        self._assembler = SampleAssembler(
            names, self._skew_limit_s, self._decoder.counter_modulo, self._ledger
        )
        self._stuck = StuckDetector(len(names), self._map.stuck)
        self._clock = BusClock()
