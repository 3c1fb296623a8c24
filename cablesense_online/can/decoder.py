"""Frames of the map to readings in N (cantools decodes), and readings of one cycle to a sample.

A sample that is not whole, late, or not valid is never filled up and never given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite
from typing import NamedTuple

import can
import numpy as np
from cantools.database.can import Database, Message

from cablesense_base import Array
from cablesense_online.can.bus import FaultKind, FaultLedger
from cablesense_online.can.channel_map import Channel, ChannelMap

CUT_SAMPLES = 8
_WIDER = 2.0
"""A pause within a sample must be so much wider than that before it to count."""


@dataclass(frozen=True, slots=True)
class Decoded:
    """The content of one frame.

    Attributes:
        readings: (channel, N) pairs; the channel is its position in the map.
        valid: whether all of them are.
        counter: of the cycle that the frame opens, if it does.
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
    """Decodes the frames of the map; notes frames that cannot be one of them.

    Attributes:
        counter_modulo: the counter starts again at 0 when it would reach this; 0 without one.
        frames_per_cycle: messages that make one sample, the counter's included.
    """

    def __init__(self, channel_map: ChannelMap, database: Database, ledger: FaultLedger) -> None:
        """`channel_map` must fit `database` (`channel_map.check_fit`)."""
        self._map, self._ledger = channel_map, ledger
        self._described = {(m.frame_id, m.is_extended_frame) for m in database.messages}
        self._plans: dict[tuple[int, bool], _Plan] = {}
        self.counter_modulo = 0
        self.frames_per_cycle = len(channel_map.message_names)
        numbered = [(n, *item) for n, item in enumerate(channel_map.channels.items())]
        for name in sorted(channel_map.message_names):
            message, counter = database.get_message_by_name(name), None
            if channel_map.counter and channel_map.counter.message == name:
                counter = channel_map.counter.signal
                self.counter_modulo = 1 << message.get_signal_by_name(counter).length
            channels = tuple(one for one in numbered if one[2].message == name)
            key = (message.frame_id, message.is_extended_frame)
            self._plans[key] = _Plan(message, channels, counter)

    def knows(self, frame: can.Message) -> bool:
        """Whether the frame's id is one that carries readings or the counter."""
        return (frame.arbitration_id, frame.is_extended_id) in self._plans

    def decode(self, frame: can.Message) -> Decoded | None:
        """A frame's content; None for one without, which is noted unless the DBC describes it.

        A frame of the right id whose length is wrong has none: what its bytes mean is open.
        """
        key = (frame.arbitration_id, frame.is_extended_id)
        plan = self._plans.get(key)
        if plan is None:
            if key not in self._described:
                self._ledger.note(FaultKind.UNKNOWN_ID, f"0x{frame.arbitration_id:X}")
            return None
        name, length = plan.message.name, plan.message.length
        if frame.is_remote_frame or frame.is_fd:
            detail = f"{name} came as a remote or CAN FD frame, not as a data frame"
            self._ledger.note(FaultKind.UNREADABLE, name, detail)
            return None
        if len(frame.data) != length:
            detail = f"{name} came with {len(frame.data)} bytes; the DBC file gives it {length}"
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
            if status or not low < tension_n < high:
                fault = self._fault(tension_n, status)
                if fault is not None:
                    valid = False
                    suffix = f", status 0x{status:02X}" if status else ""
                    self._ledger.note(fault, cable, f"{cable} reads {tension_n:g} N{suffix}")
            readings.append((number, tension_n))
        counter = int(values[plan.counter]) if plan.counter is not None else None
        return Decoded(readings, valid, counter)

    def _fault(self, tension_n: float, status: int) -> FaultKind | None:
        """A reading at or beyond an end of the range is none: the tension lies beyond."""
        (low, high), masks = self._map.range_n, self._map.status_masks
        for applies, kind in (
            (status & masks.over_range, FaultKind.OVER_RANGE),
            (status & masks.under_range, FaultKind.UNDER_RANGE),
            (status & masks.invalid, FaultKind.INVALID_STATUS),
            (not isfinite(tension_n), FaultKind.NOT_FINITE),
            (tension_n >= high, FaultKind.OVER_RANGE),
            (tension_n <= low, FaultKind.UNDER_RANGE),
        ):
            if applies:
                return kind
        return None


@dataclass(frozen=True, slots=True)
class Sample:
    """One reading of every channel, all within the skew limit.

    Attributes:
        time_s: bus time of its first frame: an amplifier measures before it sends.
        skew_s: bus time from the first to the last frame.
        tensions_n: (M,) in the order of the map.
    """

    time_s: float
    skew_s: float
    tensions_n: Array


class SampleAssembler:
    """Puts samples together.

    With a cycle counter, its frame opens a sample, and only frames until the next one belong to
    it. Without, the first frame after a sample opens the next, and a channel that comes a second
    time, or later than the skew limit, ends an unfinished one and opens another: late and lost
    cannot be distinguished then. After a lost frame every sample would be cut in mid-cycle; where
    the widest pause lies within `CUT_SAMPLES` samples one after the other, and not between them,
    samples begin anew at that pause. A sample that is not whole is dropped, and the channels that
    it lacks are named.

    Attributes:
        dropped: samples dropped so far because they were late, not whole, or not valid.
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
        self._earliest_s = self._latest_s = 0.0
        self._valid, self._late = True, False
        self._frames: list[tuple[float, Decoded]] = []
        self._last_end_s = float("-inf")
        self._cut = 0
        self.dropped = 0

    def take(self, decoded: Decoded, time_s: float) -> Sample | None:
        """Put a frame in with its bus time; give the sample that it completes."""
        if decoded.counter is not None:
            self.close()
            self._open(time_s)
            self._count(decoded.counter)
        if not decoded.readings:
            return None
        if self._open_s is None:
            if self._modulo:
                return None  # the rest of a cycle whose beginning did not come
            self._open(time_s)
        earliest_s, latest_s = min(self._earliest_s, time_s), max(self._latest_s, time_s)
        late = latest_s - earliest_s > self._skew_limit_s
        if late or any(channel not in self._missing for channel, _ in decoded.readings):
            self._note_late(decoded, time_s, late)
            if self._modulo:
                self._late = True
            else:
                self.close()
                self._open(time_s)
        else:
            self._earliest_s, self._latest_s = earliest_s, latest_s
        self._fill(decoded, time_s)
        if self._missing or (not self._modulo and self._begins_anew()):
            return None
        opened_s, self._open_s = self._open_s, None
        if not self._valid or self._late or opened_s is None:
            self.dropped += 1
            return None
        return Sample(opened_s, time_s - opened_s, np.array(self._tensions_n))

    def restart(self) -> None:
        """The interface was opened again: what came before has no bearing on what comes."""
        self._open_s = self._last_count = None
        self._last_end_s, self._cut = float("-inf"), 0

    def close(self) -> None:
        """Give up the open sample, if any: nothing came for longer than a cycle."""
        if self._open_s is None:
            return
        for channel in sorted(self._missing):
            self._ledger.note(FaultKind.MISSING_CHANNEL, self._names[channel])
        self._open_s = None
        self.dropped += 1

    def _open(self, time_s: float) -> None:
        self._open_s = self._earliest_s = self._latest_s = time_s
        self._frames.clear()
        self._missing = set(range(len(self._names)))
        self._valid, self._late = True, False

    def _fill(self, decoded: Decoded, time_s: float) -> None:
        for channel, tension_n in decoded.readings:
            self._tensions_n[channel] = tension_n
            self._missing.discard(channel)
        self._valid = self._valid and decoded.valid
        if not self._modulo:
            self._frames.append((time_s, decoded))

    def _begins_anew(self) -> bool:
        """Whether samples are cut in mid-cycle; the open one begins at the pause then."""
        times_s = [time_s for time_s, _ in self._frames]
        pauses_s = [after - before for before, after in pairwise(times_s)]
        before_s, self._last_end_s = times_s[0] - self._last_end_s, times_s[-1]
        widest_s = max(pauses_s, default=0.0)
        self._cut = self._cut + 1 if widest_s > _WIDER * before_s else 0
        if self._cut < CUT_SAMPLES:
            return False
        self._cut = 0
        of_next = self._frames[pauses_s.index(widest_s) + 1 :]
        self._open(of_next[0][0])
        for time_s, decoded in of_next:
            self._fill(decoded, time_s)
            for channel, _ in decoded.readings:
                name = self._names[channel]
                detail = f"{name} was taken into the cycle before its own; samples begin anew"
                self._ledger.note(FaultKind.LATE_CHANNEL, name, detail)
        self.dropped += 1
        return True

    def _note_late(self, decoded: Decoded, time_s: float, late: bool) -> None:
        after_ms = (time_s - (self._open_s or 0.0)) * 1e3
        for channel, _ in decoded.readings:
            name = self._names[channel]
            if late and channel in self._missing:
                detail = f"{name} came {after_ms:.2f} ms after the sample's first frame"
                detail += f"; the skew limit is {self._skew_limit_s * 1e3:g} ms"
                self._missing.discard(channel)  # named once: as late, not as missing too
            elif self._modulo:
                detail = f"{name} came twice in one cycle, so that the first was of the one before"
            else:
                continue  # of the next sample; what the open one lacks is named when it is closed
            self._ledger.note(FaultKind.LATE_CHANNEL, name, detail)

    def _count(self, count: int) -> None:
        last, self._last_count = self._last_count, count
        if last is None:
            return
        steps = (count - last) % self._modulo
        if steps == 0:
            self._valid = False  # the amplifier sends old values again
            detail = f"the cycle counter stands still at {count}"
        elif steps > 1:
            detail = f"the cycle counter went from {last} to {count}: {steps - 1} cycles lost"
        else:
            return
        self._ledger.note(FaultKind.COUNTER_GAP, "cycle counter", detail)
