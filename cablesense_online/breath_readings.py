"""The readings of an arm that breathes, freed from friction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import BREATH_END, Level, Status
from cablesense_online.state import BreathState

SILENT_AFTER_S = 1.0
"""A breather that has sent nothing for this long in mid-breath is assumed to have gone."""
_REST_S = 0.1
"""Readings at rest are averaged over this time to find the friction, and over one at least."""
_FEWEST, _LARGEST_GAP = 8, 0.2
"""Readings of a turn, and the longest time between two of them, in turns."""
_SHIFT_N = 1.0
"""Added before the logarithm: that of a slack cable's noise would weigh as much as a load's."""
_BEYOND_N = 1.0
"""By how much a reading at rest may exceed the range of the turn before."""
_NONE: Final = np.zeros(0)


class BreathReadings:
    """Takes readings and the marks of a breath as they come; gives the tensions to answer from.

    Over each whole turn of a breath the readings' logarithms are averaged. Their mean is answered
    from, from the end of the turn to the end of the next. When the breath is over and the arm at
    rest again, each cable's reading differs from that mean by its friction. Readings are corrected
    by this difference until the arm is commanded elsewhere.

    Attributes:
        state: progress and results of the breath.
        learnt: whether the last reading ended a turn, or the wait for rest after a breath.
    """

    def __init__(self, settle_s: float) -> None:
        """`settle_s` is waited after the end of a breath."""
        self._settle_ns = round(settle_s * 1e9)
        self._messages, self._last_message = 0, (0, 0.0)
        self._lasting, self._problem = False, ""
        self.learnt = False
        self.state = BreathState()

    def mark(self, turn: int, stamp_ns: int, *, lasting: bool = False) -> bool:
        """A message of the breather with this turn and stamp; gives whether that is another turn.

        `lasting` marks an offset of the cables that is no breath's and need not be repeated.
        """
        state = self.state
        self._messages += 1
        self._lasting = lasting
        if turn == (state.mark_turn if state.mark_ns else state.turn):
            return False
        if state.mark_ns:  # no reading came since the previous mark
            self._enter(state.mark_turn, 0)
            self._lose_turn()
        if not self.breathing:
            self._problem = ""
        state.mark_turn, state.mark_ns = turn, stamp_ns
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
        """End the breath here, without any knowledge of friction, for a `problem`."""
        self._enter(BREATH_END, 0)
        self.moved()
        self.state.mark_ns, self._problem = 0, problem

    def moved(self) -> None:
        """Forget the friction: it is unknown where the arm was commanded to."""
        self.state.reading_n = self.state.offset_n = _NONE
        self.state.from_ns = self.state.ended_ns = 0

    @property
    def breathing(self) -> bool:
        """Whether the arm is away from its command on purpose."""
        state = self.state
        return (state.mark_turn if state.mark_ns else state.turn) != BREATH_END

    @property
    def known(self) -> bool:
        """Whether answers rest on a breath."""
        return self.state.reading_n.size > 0 or self.state.offset_n.size > 0

    def without_friction(
        self, tensions_n: Sequence[float], stamp_ns: int
    ) -> Sequence[float] | None:
        """The tensions to answer from at a reading (M,), N; None before a breath has a result."""
        self.learnt = False
        state = self.state
        if state.mark_ns:
            self._pass_mark(tensions_n, stamp_ns)
        elif state.turn > 0:
            self._add(tensions_n, stamp_ns)
        if state.turn == BREATH_END:
            if state.offset_n.size:
                return (state.offset_n + tensions_n).tolist()
            if not state.ended_ns:
                return tensions_n
            rested_ns = stamp_ns - state.ended_ns - self._settle_ns
            if rested_ns >= 0:
                if not state.reading_n.size:
                    state.ended_ns = 0
                    return tensions_n
                return self._at_rest(np.array(tensions_n), rested_ns).tolist()
        return state.reading_n.tolist() if state.reading_n.size else None

    def status(self) -> Status | None:
        """The results of breathing; None where there has been none."""
        state = self.state
        if self._problem:
            return Status(
                "breathing", Level.ERROR, f"{self._problem}; friction is in the readings"
            )
        loop_n = 0.5 * (state.highest_n - state.lowest_n)
        values = {"friction of each cable (N)": ", ".join(f"{half:.1f}" for half in loop_n)}
        if self.breathing:
            message = "breathing" if self.known else "breathing: no estimate before a whole turn"
            return Status("breathing", Level.OK, message, values)
        if state.offset_n.size:
            values["readings corrected by (N)"] = ", ".join(f"{n:+.1f}" for n in state.offset_n)
            return Status("breathing", Level.OK, "breathed at this command", values)
        if state.ended_ns:
            return Status("breathing", Level.OK, "coming to rest after a breath", values)
        if loop_n.size:
            message = "moved since the last breath: friction is in the readings"
            return Status("breathing", Level.WARN, message, values)
        return None

    def _pass_mark(self, tensions_n: Sequence[float], stamp_ns: int) -> None:
        """End the turn, and begin the next, where the mark lies between two readings."""
        state = self.state
        at_ns = max(state.mark_ns, state.last_ns)
        if stamp_ns < at_ns and state.turn != BREATH_END:
            if state.turn > 0:
                self._add(tensions_n, stamp_ns)
            return
        self.learnt = state.turn > 0
        if state.turn > 0:
            self._add(tensions_n, at_ns)
            lasted_ns = at_ns - state.from_ns
            enough = state.count >= _FEWEST and state.gap_ns <= _LARGEST_GAP * lasted_ns
            if state.from_ns and enough:
                state.reading_n = np.exp(state.sum_log_n / (1e-9 * lasted_ns)) - _SHIFT_N
                self._problem = ""
            else:
                self._lose_turn()
        self._enter(state.mark_turn, at_ns)
        state.mark_ns = 0
        if state.turn > 0:
            self._add(tensions_n, stamp_ns)

    def _lose_turn(self) -> None:
        self.state.reading_n = _NONE
        self._problem = (
            f"a turn of the breath had {self.state.count} samples, up to "
            f"{1e-6 * self.state.gap_ns:.0f} ms apart; it needs {_FEWEST}, and no gap of "
            f"{_LARGEST_GAP:g} turns"
        )

    def _enter(self, turn: int, at_ns: int) -> None:
        state = self.state
        seen_from_its_beginning = state.turn != BREATH_END
        if not seen_from_its_beginning:
            state.reading_n = state.offset_n = _NONE
        state.turn = turn
        state.from_ns = state.last_ns = state.count = state.gap_ns = 0
        state.ended_ns = state.rest_count = 0
        if turn > 0 and seen_from_its_beginning:
            state.from_ns = state.last_ns = at_ns
            state.sum_log_n = state.lowest_n = state.highest_n = _NONE
        elif turn == BREATH_END:
            state.ended_ns, state.rest_n = at_ns, _NONE

    def _add(self, tensions_n: Sequence[float], until_ns: int) -> None:
        """Weight a reading by the time since the previous one."""
        state = self.state
        if until_ns < state.last_ns:
            state.from_ns = 0  # a clock was set: this turn does not count
        if not state.from_ns:
            return
        reading = np.array(tensions_n)
        passed_ns = until_ns - state.last_ns
        weighted = np.log(np.maximum(reading, 0.0) + _SHIFT_N) * (1e-9 * passed_ns)
        if state.count:
            state.sum_log_n = state.sum_log_n + weighted
            state.lowest_n = np.minimum(state.lowest_n, reading)
            state.highest_n = np.maximum(state.highest_n, reading)
        else:
            state.sum_log_n, state.lowest_n, state.highest_n = weighted, reading, reading
        state.count += 1
        state.gap_ns = max(state.gap_ns, passed_ns)
        state.last_ns = until_ns

    def _at_rest(self, reading: Array, rested_ns: int) -> Array:
        """The mean of the breath, until the friction left in the readings is known."""
        state = self.state
        state.rest_n = state.rest_n + reading if state.rest_count else reading
        state.rest_count += 1
        if rested_ns < _REST_S * 1e9:
            return state.reading_n
        mean = state.rest_n / state.rest_count
        self.learnt = True
        beyond = np.maximum(state.lowest_n - mean, mean - state.highest_n).max()
        if beyond > _BEYOND_N:
            self.give_up(f"the load changed by {beyond:.1f} N of a cable during the breath")
            return reading
        state.offset_n = state.reading_n - mean
        return np.asarray(reading + state.offset_n)
