"""What readings would be without friction: averaged over a breath's turns, corrected after it.

The mean of the readings' logarithms over each whole turn of a breath (`breathing`) is answered
from until the end of the next. When the breath is over and the arm at rest again, each cable's
reading differs from that mean by its friction. Readings are corrected by this difference until the
arm is commanded elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import BREATH_END

_REST_NS = 100_000_000
"""Readings at rest are averaged over this time to find the friction, and over one at least."""
_FEWEST = 8
"""Readings of a turn, at least."""
_LARGEST_GAP = 0.2
"""The longest time between two of them, in turns."""
_SHIFT_N = 1.0
"""Added before the logarithm: that of a slack cable's noise would weigh as much as a load's."""
_BEYOND_N = 1.0
"""By how much a reading at rest may exceed the range of the turn before."""
_NONE: Final = np.zeros(0)


@dataclass(frozen=True)
class TurnSum:
    """The readings of one turn so far.

    Attributes:
        from_ns: stamp of the turn's beginning; 0 where the turn does not count.
        last_ns: stamp of the last reading.
        count: number of readings.
        gap_ns: longest time between two.
        log_sum: (M,) sum of their logarithms, weighted by time in s.
        lowest_n, highest_n: (M,) range of the readings.
    """

    from_ns: int = 0
    last_ns: int = 0
    count: int = 0
    gap_ns: int = 0
    log_sum: Array = field(default_factory=lambda: _NONE)
    lowest_n: Array = field(default_factory=lambda: _NONE)
    highest_n: Array = field(default_factory=lambda: _NONE)

    def with_reading(self, tensions_n: Sequence[float], until_ns: int) -> TurnSum:
        """With a reading (M,) that weighs as much as the time since the previous one."""
        if not self.from_ns:
            return self
        if until_ns < self.last_ns:
            return replace(self, from_ns=0)  # a clock was set: this turn does not count
        reading = np.array(tensions_n)
        passed_ns = until_ns - self.last_ns
        log_sum = np.log(np.maximum(reading, 0.0) + _SHIFT_N) * (1e-9 * passed_ns)
        lowest_n = reading
        highest_n = reading
        if self.count:
            log_sum = self.log_sum + log_sum
            lowest_n = np.minimum(self.lowest_n, reading)
            highest_n = np.maximum(self.highest_n, reading)
        return TurnSum(
            self.from_ns,
            until_ns,
            self.count + 1,
            max(self.gap_ns, passed_ns),
            log_sum,
            lowest_n,
            highest_n,
        )

    def mean_n(self, until_ns: int) -> Array | None:
        """(M,) mean of the whole turn; None where it has too few readings, or does not count."""
        lasted_ns = until_ns - self.from_ns
        enough = self.count >= _FEWEST and self.gap_ns <= _LARGEST_GAP * lasted_ns
        if not self.from_ns or not enough:
            return None
        return np.asarray(np.exp(self.log_sum / (1e-9 * lasted_ns)) - _SHIFT_N)

    @property
    def problem(self) -> str:
        """What is wrong with a turn that has no mean."""
        return (
            f"a turn of the breath had {self.count} samples, up to {1e-6 * self.gap_ns:.0f} ms "
            f"apart; it needs {_FEWEST}, and no gap of {_LARGEST_GAP:g} turns"
        )


@dataclass(frozen=True)
class Mark:
    """That a breath has come to another turn.

    Attributes:
        turn: as `messages.breath_turn` numbers them.
        stamp_ns: when.
    """

    turn: int
    stamp_ns: int


@dataclass(frozen=True)
class BreathState:
    """Progress and results of a breath.

    Attributes:
        turn: turn of the last reading, as `messages.breath_turn` numbers them.
        readings: of that turn, or of the last one that counted.
        mark: that the next reading passes, if any.
        mean_n: (M,) mean of the last whole turn; empty where none counts.
        ended_ns: stamp of the breath's end; 0 where no rest is awaited.
        rest_n: (M,) sum of the readings at rest since, and
        rest_count: their number.
        offset_n: (M,) correction of the readings for friction; empty where it is not known.
        problem: why the last breath has no result; empty where it has.
    """

    turn: int = BREATH_END
    readings: TurnSum = field(default_factory=TurnSum)
    mark: Mark | None = None
    mean_n: Array = field(default_factory=lambda: _NONE)
    ended_ns: int = 0
    rest_n: Array = field(default_factory=lambda: _NONE)
    rest_count: int = 0
    offset_n: Array = field(default_factory=lambda: _NONE)
    problem: str = ""

    @property
    def latest_turn(self) -> int:
        """Where the breath is by the last mark."""
        return self.turn if self.mark is None else self.mark.turn

    @property
    def breathing(self) -> bool:
        """Whether the arm is away from its command on purpose."""
        return self.latest_turn != BREATH_END

    @property
    def known(self) -> bool:
        """Whether answers rest on a breath."""
        return self.mean_n.size > 0 or self.offset_n.size > 0

    @property
    def moved(self) -> BreathState:
        """The same without knowledge of friction: it is unknown where the arm was commanded to."""
        readings = replace(self.readings, from_ns=0)
        return replace(self, readings=readings, mean_n=_NONE, offset_n=_NONE, ended_ns=0)

    def given_up(self, problem: str) -> BreathState:
        """The breath ended here, without any knowledge of friction, for a `problem`."""
        return replace(_entered(self, BREATH_END, 0).moved, mark=None, problem=problem)

    def marked(self, mark: Mark) -> BreathState:
        """With a mark of the breather."""
        if mark.turn == self.latest_turn:
            return self
        state = self
        if state.mark is not None:  # no reading came since the previous mark
            state = _lost(_entered(state, state.mark.turn, 0))
        problem = state.problem if state.breathing else ""
        return replace(state, mark=mark, problem=problem)


def after_reading(
    state: BreathState, tensions_n: Sequence[float], stamp_ns: int, settle_ns: int
) -> tuple[BreathState, Sequence[float] | None]:
    """The state after a reading (M,), N, and the tensions to answer from.

    These are None before a breath has a result. `settle_ns` is waited after the end of a breath.
    """
    if state.mark is not None:
        state = _past_mark(state, state.mark, tensions_n, stamp_ns)
    elif state.turn > 0:
        state = _with_reading(state, tensions_n, stamp_ns)
    if state.turn != BREATH_END:
        return state, state.mean_n.tolist() if state.mean_n.size else None
    if state.offset_n.size:
        return state, (state.offset_n + tensions_n).tolist()
    rested_ns = stamp_ns - state.ended_ns - settle_ns
    if state.ended_ns and rested_ns >= 0:
        if state.mean_n.size:
            return _at_rest(state, np.array(tensions_n), rested_ns)
        state = replace(state, ended_ns=0)
    if not state.ended_ns:
        return state, tensions_n
    return state, state.mean_n.tolist() if state.mean_n.size else None


def _past_mark(
    state: BreathState, mark: Mark, tensions_n: Sequence[float], stamp_ns: int
) -> BreathState:
    """With the turn ended, and the next begun, where the mark lies between two readings."""
    at_ns = max(mark.stamp_ns, state.readings.last_ns)
    if stamp_ns < at_ns and state.turn != BREATH_END:
        return _with_reading(state, tensions_n, stamp_ns) if state.turn > 0 else state
    if state.turn > 0:
        state = _with_reading(state, tensions_n, at_ns)
        mean_n = state.readings.mean_n(at_ns)
        state = _lost(state) if mean_n is None else replace(state, mean_n=mean_n, problem="")
    state = replace(_entered(state, mark.turn, at_ns), mark=None)
    return _with_reading(state, tensions_n, stamp_ns) if state.turn > 0 else state


def _with_reading(state: BreathState, tensions_n: Sequence[float], until_ns: int) -> BreathState:
    return replace(state, readings=state.readings.with_reading(tensions_n, until_ns))


def _lost(state: BreathState) -> BreathState:
    """Without the mean of the last turn, as it had too few readings."""
    return replace(state, mean_n=_NONE, problem=state.readings.problem)


def _entered(state: BreathState, turn: int, at_ns: int) -> BreathState:
    """In another turn, from a stamp on."""
    seen_from_its_beginning = state.turn != BREATH_END
    counts = turn > 0 and seen_from_its_beginning
    # the range of the last turn says how much friction there was
    readings = replace(state.readings, from_ns=0, last_ns=0, count=0, gap_ns=0)
    if counts:
        readings = TurnSum(from_ns=at_ns, last_ns=at_ns)
    return replace(
        state,
        turn=turn,
        readings=readings,
        mean_n=state.mean_n if seen_from_its_beginning else _NONE,
        offset_n=state.offset_n if seen_from_its_beginning else _NONE,
        ended_ns=at_ns if turn == BREATH_END else 0,
        rest_n=_NONE if turn == BREATH_END else state.rest_n,
        rest_count=0,
    )


def _at_rest(
    state: BreathState, reading_n: Array, rested_ns: int
) -> tuple[BreathState, Sequence[float]]:
    """The mean of the breath, until the friction left in the readings is known."""
    rest_n = state.rest_n + reading_n if state.rest_count else reading_n
    state = replace(state, rest_n=rest_n, rest_count=state.rest_count + 1)
    if rested_ns < _REST_NS:
        return state, state.mean_n.tolist()
    at_rest_n = state.rest_n / state.rest_count
    readings = state.readings
    off_n = np.maximum(readings.lowest_n - at_rest_n, at_rest_n - readings.highest_n)
    beyond_n = off_n.max()
    if beyond_n > _BEYOND_N:
        problem = f"the load changed by {beyond_n:.1f} N of a cable during the breath"
        return state.given_up(problem), reading_n.tolist()
    offset_n = state.mean_n - at_rest_n
    return replace(state, offset_n=offset_n), (reading_n + offset_n).tolist()
