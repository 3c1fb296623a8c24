"""Samples of decoded frames: assembled, held until their cycle is over, withheld if in doubt.

Nothing in a CAN frame tells who sent it. A second sender shows by its frames coming next to those
of the amplifier, so a sample is given only after the amplifier has had the time to send its own.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_online.can.bus import FaultKind, FaultLedger

DISTRUST_S = 10.0
"""For so long after its last fault, no sample with frames of an id is given."""
AGAIN_CYCLES = 0.25
"""A frame that the one before it equals, so soon after it, was sent again by its own sender: CAN
does so if another node saw an error in the last bits of a frame that this one has taken."""
THREE_FRAMES_CYCLES = 1.3
"""Cycles below which three frames of one id are those of two senders: from one sender they take
two, or 1.4 in the least favourable order of twelve, and from two they take one."""
EARLY_CYCLES = 1.0
"""Jitter, in cycles, by which a counter may be ahead of time."""
HELD_UP_CYCLES = 1000.0
"""The longest time, in cycles, that a reader that was held up makes up."""
SLOWER_SHARE = 0.01
"""Share by which an amplifier may be slower than the map says, so that it gains no time."""
CUT_SAMPLES = 8
"""Successive samples with a pause inside that show that samples begin in mid-cycle: bus traffic
delays single frames only."""
CUT_PAUSE_RATIO = 2.0
"""How many times as long as the pause before its sample such a pause inside is."""


class Decoded(NamedTuple):
    """The content of one frame.

    Attributes:
        readings: (channel, N) pairs; the channel is its position in the map.
        counter: the number of the cycle that the frame opens, if it opens one.
        message: name and id of the frame.
    """

    readings: Sequence[tuple[int, float]] = ()
    valid: bool = True
    counter: int | None = None
    message: str = ""


@dataclass(frozen=True, slots=True)
class AssembledSample:
    """One reading of every channel, all within the skew limit.

    Attributes:
        time_s: bus time of its first frame, because an amplifier measures before it sends.
        skew_s: bus time from the first to the last frame.
        tensions_n: (M,) in the order of the map.
    """

    time_s: float
    skew_s: float
    tensions_n: Array


class _Senders:
    """Finds ids with a second sender, and counters that jump.

    `frames` is the number of frames of each message since the cycle was opened.
    """

    def __init__(
        self, cycle_time_s: float, counter_modulo: int, stamped: bool, ledger: FaultLedger
    ) -> None:
        self._cycle_s = cycle_time_s
        self._modulo = counter_modulo
        self._stamped = stamped
        self._ledger = ledger
        self._last = Decoded()
        self._last_s = -np.inf
        self._count: int | None = None
        self._count_s = 0.0
        self._spare_cycles = 0.0
        self._times_s: dict[str, deque[float]] = {}
        self._faults: dict[str, tuple[float, str]] = {}
        self.frames: Counter[str] = Counter()

    def sent_again(self, decoded: Decoded, time_s: float) -> bool:
        """Whether the frame is the one before it once more, and has no effect."""
        soon = time_s - self._last_s < AGAIN_CYCLES * self._cycle_s
        again = soon and decoded == self._last
        self._last = decoded
        self._last_s = time_s
        if again:
            detail = f"{decoded.message} came twice with the same content; the second is not used"
            self._ledger.note(FaultKind.DUPLICATE_ID, decoded.message, detail)
        return again

    def take(self, message: str, time_s: float) -> None:
        """Note a frame; without a counter, the third of its id within one cycle is a fault."""
        self.frames[message] += 1
        if self._modulo or not self._stamped:
            return
        times_s = self._times_s.setdefault(message, deque(maxlen=2))
        span_s = time_s - times_s[0] if len(times_s) == 2 else np.inf
        times_s.append(time_s)
        if 0.0 <= span_s < THREE_FRAMES_CYCLES * self._cycle_s:
            text = f"came three times in {span_s:.5f} s; cycle_time_s is {self._cycle_s:g}"
            self._distrust(FaultKind.DUPLICATE_ID, message, text, time_s)

    def counts_on(self, decoded: Decoded, count: int, time_s: float) -> tuple[bool, bool]:
        """Whether a counter moved, and whether the frames before it are of one cycle.

        If it stands still, the amplifier repeats old values. Lost cycles take their time. A
        counter that is ahead of it is another sender's, or a restarted amplifier's. If only the
        time of reading is known, a reader that was held up makes up for it afterwards; a counter
        that is ahead must then also have gone back. Frames around a lost counter frame are then
        of one cycle if none of them was lost.
        """
        last = self._count
        self._count = count
        steps = 1 if last is None else (count - last) % self._modulo
        passed = max(0.0, time_s - self._count_s) / self._cycle_s if last is not None else 1.0
        self._count_s = time_s
        spare = max(0.0, self._spare_cycles - SLOWER_SHARE * passed) + passed - steps
        most = EARLY_CYCLES if self._stamped else HELD_UP_CYCLES
        self._spare_cycles = min(max(0.0, spare), most)
        moved = f"the cycle counter went from {last} to {count}"
        ahead = spare < -EARLY_CYCLES and (self._stamped or 2 * steps > self._modulo)
        if steps and ahead:
            text = f"{moved} within {passed:.1f} cycles: sent again or by another, or restarted"
            self._distrust(FaultKind.COUNTER_JUMP, decoded.message, text, time_s)
        elif steps != 1:
            text = f"{moved}: " + (f"{steps - 1} cycles lost" if steps else "it stands still")
            self._ledger.note(FaultKind.COUNTER_GAP, "cycle counter", text)
        of_one = steps < 2 or self._stamped or set(self.frames.values()) == {steps}
        for message, frames in self.frames.items():
            if frames > max(1, steps) and last is not None:
                text = f"came {frames} times in one cycle"
                self._distrust(FaultKind.DUPLICATE_ID, message, text, time_s)
        self.frames.clear()
        return steps > 0, of_one

    def distrusted(self, time_s: float) -> bool:
        """Whether any id is; names those that are, as this costs a sample."""
        any_is = False
        for message, (since_s, text) in self._faults.items():
            if 0.0 <= time_s - since_s < DISTRUST_S:
                self._ledger.note(FaultKind.DISTRUSTED_ID, message, text)
                any_is = True
        return any_is

    def _distrust(self, kind: FaultKind, message: str, text: str, time_s: float) -> None:
        self._ledger.note(kind, message, f"{message}: {text}")
        until = f"no sample until {DISTRUST_S:g} s without that, or the driver is activated again"
        self._faults[message] = time_s, f"{message}: {text}; {until}"


class SampleAssembler:
    """Assembles samples.

    With a cycle counter, its frame opens a sample, and only frames until the next one belong to
    it. Without one, the first frame after a sample opens the next. A channel that comes a second
    time, or later than the skew limit, then ends an unfinished sample and opens another. After a
    lost frame, samples may begin in mid-cycle: frames then wait for the pause between two cycles.

    A whole sample is held until the next counter frame or, without a counter, until the next
    sample has ended: by then each amplifier has sent again. With neither a counter nor the time
    of the bus, nothing could be learned by then, and it is given at once.

    Attributes:
        dropped: number of samples dropped: late, not whole, invalid or distrusted.
        frame_s: bus time of the last frame with readings.
    """

    def __init__(
        self,
        cable_names: Sequence[str],
        cycle_time_s: float,
        skew_limit_s: float,
        counter_modulo: int,
        ledger: FaultLedger,
        stamped: bool = True,
    ) -> None:
        """`counter_modulo` is 0 without one; `stamped` frames have the time of the bus."""
        self._names = tuple(cable_names)
        self._skew_limit_s = skew_limit_s
        self._modulo = counter_modulo
        self._holds = stamped or counter_modulo > 0
        self._ledger = ledger
        self._senders = _Senders(cycle_time_s, counter_modulo, stamped, ledger)
        self._tensions_n = [0.0] * len(self._names)
        self._missing = set(range(len(self._names)))
        self._open_s: float | None = None
        self._held: AssembledSample | None = None
        self._valid = True
        self._pause_before_s = 0.0
        self._widest_pause_s = 0.0
        self._awaited_pause_s = 0.0
        self._cut = 0
        self.dropped = 0
        self.frame_s = -np.inf

    def take(self, decoded: Decoded, time_s: float) -> AssembledSample | None:
        """Add a frame with its bus time, and give the sample that may be given now, if any."""
        if self._senders.sent_again(decoded, time_s):
            return None
        released = None
        if decoded.counter is not None:
            moved, of_one = self._senders.counts_on(decoded, decoded.counter, time_s)
            released = self._release(time_s, trusted=moved and of_one)
            self._open(time_s)
            self._valid = moved
        if decoded.readings:
            self._senders.take(decoded.message, time_s)
            released = self._add(decoded, time_s) or released
        return released

    def lapse(self) -> AssembledSample | None:
        """Give the held sample, as no frame has come for longer than a cycle."""
        if self._modulo and max(self._senders.frames.values(), default=0) > 1:
            return None  # the next counter frame tells whether it belongs to the second ones
        return self._release(self.frame_s)

    def _add(self, decoded: Decoded, time_s: float) -> AssembledSample | None:
        released = None
        channels = [channel for channel, _ in decoded.readings]
        pause_s = time_s - self.frame_s
        self.frame_s = time_s
        if pause_s < self._awaited_pause_s:
            return None
        self._awaited_pause_s = 0.0
        if self._open_s is None:
            self._pause_before_s = pause_s
            self._widest_pause_s = 0.0
            if self._modulo:
                return None  # the rest of a cycle whose counter did not come, or a second frame
            self._open(time_s)
        else:
            self._widest_pause_s = max(self._widest_pause_s, pause_s)
            late = abs(time_s - self._open_s) > self._skew_limit_s
            if late or not self._missing.issuperset(channels):
                self._note_late(channels, time_s - self._open_s, late)
                if self._modulo:
                    self._valid = False
                else:
                    released = self._release(time_s)
                    self._open(time_s)
        for channel, tension_n in decoded.readings:
            self._tensions_n[channel] = tension_n
            self._missing.discard(channel)
        self._valid = self._valid and decoded.valid
        opened_s = self._open_s
        if self._missing or opened_s is None:
            return released
        self._open_s = None
        released = released or self._release(time_s)
        if not self._valid or self._begins_in_mid_cycle():
            self.dropped += 1
        else:
            self._held = AssembledSample(opened_s, time_s - opened_s, np.array(self._tensions_n))
        return released if self._holds else self._release(time_s)

    def _release(self, time_s: float, trusted: bool = True) -> AssembledSample | None:
        """The held sample, unless its senders are not trusted."""
        held = self._held
        self._held = None
        if held is not None and (self._senders.distrusted(time_s) or not trusted):
            self.dropped += 1
            return None
        return held

    def _open(self, time_s: float) -> None:
        """Open a sample. An unfinished one is dropped, and its missing channels are named."""
        if self._open_s is not None:
            for channel in sorted(self._missing):
                self._ledger.note(FaultKind.MISSING_CHANNEL, self._names[channel])
            self.dropped += 1
        self._open_s = time_s
        self._valid = True
        self._missing = set(range(len(self._names)))

    def _begins_in_mid_cycle(self) -> bool:
        """Whether samples without a counter are cut; the next one then waits for the pause."""
        cut = not self._modulo and self._widest_pause_s > CUT_PAUSE_RATIO * self._pause_before_s
        self._cut = self._cut + 1 if cut else 0
        if self._cut < CUT_SAMPLES:
            return False
        self._cut = 0
        self._awaited_pause_s = self._widest_pause_s / CUT_PAUSE_RATIO
        detail = (
            "samples held readings of two cycles; they begin at the pause between cycles again"
        )
        self._ledger.note(FaultKind.LATE_CHANNEL, "cycle", detail)
        return True

    def _note_late(self, channels: Sequence[int], after_s: float, late: bool) -> None:
        """A channel that comes twice is not late: it is the next sample's, or another sender's."""
        for channel in channels:
            if late and channel in self._missing:
                name = self._names[channel]
                detail = f"{name} came {after_s * 1e3:.2f} ms after the first frame; "
                detail += f"the skew limit is {self._skew_limit_s * 1e3:g} ms"
                self._ledger.note(FaultKind.LATE_CHANNEL, name, detail)
                self._missing.discard(channel)  # named as late, not as missing too
