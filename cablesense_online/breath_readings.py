"""What an arm that breathes would read without friction.

Over each whole turn of a breath the readings' logarithms are averaged (`breathing`): that mean is
what is answered from, from the end of the turn to the end of the next. When the breath is over and
the arm at rest again, each cable's reading lies off that mean by what friction has left on it; as
long as the arm is commanded nowhere else, readings are corrected by that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import BREATH_END, Level, Status
from cablesense_online.state import BreathState

SILENT_AFTER_S = 1.0
"""A breather that has sent nothing for so long in mid-breath is taken to have gone."""
_REST_S = 0.1
"""What friction has left is averaged over this, and over one reading at least."""
_FEWEST, _LARGEST_GAP = 8, 0.2
"""Readings of a turn, and the longest time between two of them, in turns."""
_SHIFT_N = 1.0
"""Added before the logarithm: that of a slack cable's noise would weigh as much as a load's."""
_BEYOND_N = 1.0
"""By how much a reading at rest may lie outside what was read on the turn before."""


class BreathReadings:
    """Takes readings and the marks of a breath as they come; gives what to answer from.

    Attributes:
        learnt: whether the last reading ended a turn, or the wait for rest after a breath.
    """

    _reading_n: Array | None
    _offset_n: Array | None
    _mark_turn: int
    _mark_ns: int

    def __init__(self, settle_s: float) -> None:
        """`settle_s` is waited after the end of a breath."""
        self._settle_ns = round(settle_s * 1e9)
        self._messages, self._last_message = 0, (0, 0.0)
        self._lasting, self._problem = False, ""
        self.learnt = False
        self.restore(BreathState())

    def mark(self, turn: int, stamp_ns: int, *, lasting: bool = False) -> bool:
        """A message of the breather with this turn and stamp; gives whether that is another turn.

        `lasting` is an offset of the cables that is no breath's, and need not be repeated.
        """
        self._messages += 1
        self._lasting = lasting
        if turn == (self._mark_turn if self._mark_ns else self._turn):
            return False
        if self._mark_ns:  # no reading came since the mark before
            self._enter(self._mark_turn, 0)
            self._lose_turn()
        if not self.breathing:
            self._problem = ""
        self._mark_turn, self._mark_ns = turn, stamp_ns
        return True

    def silent(self, now_s: float) -> bool:
        """Whether the breather seems to have gone in mid-breath.

        To be asked again and again, at monotonic times `now_s`.
        """
        messages, since_s = self._last_message
        if messages != self._messages or not self.breathing or self._lasting:
            self._last_message = self._messages, now_s
            return False
        return now_s - since_s > SILENT_AFTER_S

    def give_up(self, problem: str) -> None:
        """The breath ends here, without anything known of friction, for a `problem`."""
        self._enter(BREATH_END, 0)
        self.moved()
        self._mark_ns, self._problem = 0, problem

    def moved(self) -> None:
        """The arm was commanded elsewhere: what friction leaves there is not known."""
        self._reading_n = self._offset_n = None
        self._from_ns = self._ended_ns = 0

    @property
    def breathing(self) -> bool:
        """Whether the arm is away from its command on purpose."""
        return (self._mark_turn if self._mark_ns else self._turn) != BREATH_END

    @property
    def known(self) -> bool:
        """Whether answers rest on a breath."""
        return self._reading_n is not None or self._offset_n is not None

    def without_friction(
        self, tensions_n: Sequence[float], stamp_ns: int
    ) -> Sequence[float] | None:
        """What to answer from at a reading (M,) in N; none while nothing is known in a breath."""
        self.learnt = False
        if self._mark_ns:
            self._pass_mark(tensions_n, stamp_ns)
        elif self._turn > 0:
            self._add(tensions_n, stamp_ns)
        if self._turn != BREATH_END:
            return _list(self._reading_n)
        if self._offset_n is not None:
            return _list(self._offset_n + tensions_n)
        if not self._ended_ns:
            return tensions_n
        rested_ns = stamp_ns - self._ended_ns - self._settle_ns
        if rested_ns < 0:
            return _list(self._reading_n)
        if self._reading_n is None:
            self._ended_ns = 0
            return tensions_n
        return _list(self._at_rest(np.array(tensions_n), rested_ns))

    def state(self) -> BreathState:
        """All that the next answers rest on beside the readings to come."""
        return BreathState(
            turn=self._turn,
            from_ns=self._from_ns,
            last_ns=self._last_ns,
            count=self._count,
            gap_ns=self._gap_ns,
            sum_log_n_s=_numbers(self._sum_s),
            lowest_n=_numbers(self._lowest_n),
            highest_n=_numbers(self._highest_n),
            mark_turn=self._mark_turn,
            mark_ns=self._mark_ns,
            reading_n=_numbers(self._reading_n),
            ended_ns=self._ended_ns,
            rest_n=_numbers(self._rest_n),
            rest_count=self._rest_count,
            offset_n=_numbers(self._offset_n),
        )

    def restore(self, state: BreathState) -> None:
        """Go on from a state."""
        self._turn, self._from_ns, self._last_ns = state.turn, state.from_ns, state.last_ns
        self._count, self._gap_ns = state.count, state.gap_ns
        self._mark_turn, self._mark_ns = state.mark_turn, state.mark_ns
        self._ended_ns, self._rest_count = state.ended_ns, state.rest_count
        self._sum_s, self._lowest_n, self._highest_n, self._rest_n = (
            np.array(numbers)
            for numbers in (state.sum_log_n_s, state.lowest_n, state.highest_n, state.rest_n)
        )
        self._reading_n, self._offset_n = (
            np.array(numbers) if numbers else None for numbers in (state.reading_n, state.offset_n)
        )

    def status(self) -> Status | None:
        """What breathing has shown; none where there has been none."""
        if self._problem:
            return Status(
                "breathing", Level.ERROR, f"{self._problem}; friction is in the readings"
            )
        loop_n = 0.5 * (self._highest_n - self._lowest_n)
        values = {"friction of each cable (N)": ", ".join(f"{half:.1f}" for half in loop_n)}
        if self.breathing:
            message = "breathing" if self.known else "breathing: no estimate before a whole turn"
            return Status("breathing", Level.OK, message, values)
        if self._ended_ns and self._offset_n is None:
            return Status("breathing", Level.OK, "coming to rest after a breath", values)
        if self._offset_n is not None:
            values["readings corrected by (N)"] = ", ".join(f"{n:+.1f}" for n in self._offset_n)
            return Status("breathing", Level.OK, "breathed at this command", values)
        if loop_n.size:
            message = "moved since the last breath: friction is in the readings"
            return Status("breathing", Level.WARN, message, values)
        return None

    def _pass_mark(self, tensions_n: Sequence[float], stamp_ns: int) -> None:
        """The turn ends, and the next begins, where the mark lies between two readings."""
        at_ns = max(self._mark_ns, self._last_ns)
        if stamp_ns < at_ns and self._turn != BREATH_END:
            if self._turn > 0:
                self._add(tensions_n, stamp_ns)
            return
        self.learnt = self._turn > 0
        if self._turn > 0:
            self._add(tensions_n, at_ns)
            lasted_ns = at_ns - self._from_ns
            enough = self._count >= _FEWEST and self._gap_ns <= _LARGEST_GAP * lasted_ns
            if self._from_ns and enough:
                self._reading_n = np.exp(self._sum_s / (1e-9 * lasted_ns)) - _SHIFT_N
                self._problem = ""
            else:
                self._lose_turn()
        self._enter(self._mark_turn, at_ns)
        self._mark_ns = 0
        if self._turn > 0:
            self._add(tensions_n, stamp_ns)

    def _lose_turn(self) -> None:
        self._reading_n = None
        self._problem = (
            f"a turn of the breath had {self._count} samples, up to {1e-6 * self._gap_ns:.0f} ms "
            f"apart; it needs {_FEWEST}, and no gap of {_LARGEST_GAP:g} turns"
        )

    def _enter(self, turn: int, at_ns: int) -> None:
        seen_from_its_beginning = self._turn != BREATH_END
        if not seen_from_its_beginning:
            self._reading_n = self._offset_n = None
        self._turn = turn
        self._from_ns = self._last_ns = self._count = self._gap_ns = 0
        self._ended_ns = self._rest_count = 0
        if turn > 0 and seen_from_its_beginning:
            self._from_ns = self._last_ns = at_ns
            self._sum_s = self._lowest_n = self._highest_n = np.zeros(0)
        elif turn == BREATH_END:
            self._ended_ns, self._rest_n = at_ns, np.zeros(0)

    def _add(self, tensions_n: Sequence[float], until_ns: int) -> None:
        """A reading counts for the time since the one before."""
        if until_ns < self._last_ns:
            self._from_ns = 0  # a clock was set: this turn does not count
        if not self._from_ns:
            return
        reading = np.array(tensions_n)
        passed_ns = until_ns - self._last_ns
        weighed = np.log(np.maximum(reading, 0.0) + _SHIFT_N) * (1e-9 * passed_ns)
        if self._count:
            self._sum_s = self._sum_s + weighed
            self._lowest_n = np.minimum(self._lowest_n, reading)
            self._highest_n = np.maximum(self._highest_n, reading)
        else:
            self._sum_s, self._lowest_n, self._highest_n = weighed, reading, reading
        self._count += 1
        self._gap_ns = max(self._gap_ns, passed_ns)
        self._last_ns = until_ns

    def _at_rest(self, reading: Array, rested_ns: int) -> Array:
        """What was read in the breath, until it is known what friction has left."""
        assert self._reading_n is not None
        self._rest_n = self._rest_n + reading if self._rest_count else reading
        self._rest_count += 1
        if rested_ns < _REST_S * 1e9:
            return self._reading_n
        mean = self._rest_n / self._rest_count
        self.learnt = True
        beyond = np.maximum(self._lowest_n - mean, mean - self._highest_n).max()
        if beyond > _BEYOND_N:
            self.give_up(f"the load changed by {beyond:.1f} N of a cable during the breath")
            return reading
        self._offset_n = self._reading_n - mean
        return np.asarray(reading + self._offset_n)


def _list(values: Array | None) -> list[float] | None:
    return None if values is None else values.tolist()


def _numbers(values: Array | None) -> tuple[float, ...]:
    return () if values is None else tuple(values.tolist())
