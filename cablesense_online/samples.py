"""Whether the values of a tension sample can be true.

Why a tension sample is of no use; no force is ever estimated from such a one.

The age of samples: stamps against this machine's clock and against each other.

What came in since the last report: rate, age, missing and refused samples.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from enum import Enum
from math import isfinite
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cablesense_base.errors import CableSenseError
from cablesense_msgs_py.diagnostics import Level, Status


class ProblemKind(Enum):
    """What is wrong with a sample; the value is what diagnostics call it."""

    MALFORMED = "malformed"
    CLOCK = "stale or from another clock"
    NAMES = "wrong names or length"
    NOT_FINITE = "not finite"
    SATURATED = "saturated"
    IMPLAUSIBLE = "implausible"
    ESTIMATE = "no finite estimate"


class SampleError(CableSenseError):
    """A sample of no use: its kind, and a sentence on what it holds and what would be right."""

    def __init__(self, kind: ProblemKind, message: str) -> None:
        super().__init__(message)
        self.kind = kind


PLAUSIBLE_N: Final = (-20.0, 20_000.0)
"""A cable pulls: readings below are a fault, not an offset; above, no such arm holds."""


class SampleCheck:
    """Refuses what no cable carries or no sensor can tell; notes slack cables, which are no fault.

    A saturated reading says only that the tension lies at or beyond the sensor's limit, so any
    force made of it would be false.
    """

    def __init__(self, range_n: tuple[float, float] | None, slack_below_n: float) -> None:
        """`range_n` is the sensors' range, if the arm file gives one."""
        self._range_n = range_n
        self.slack_below_n = slack_below_n
        self.slack: tuple[int, ...] = ()

    def check(self, tensions_n: Sequence[float]) -> None:
        """Check (M,) readings in N; then `slack` holds the numbers (from 1) of slack cables.

        Raises:
            SampleError: a reading is not finite, saturated or implausible.
        """
        low, high = self._range_n or PLAUSIBLE_N
        lowest = min(tensions_n)
        if not (isfinite(sum(tensions_n)) and low < lowest and max(tensions_n) < high):
            raise self._problem(tensions_n)
        self.slack = (
            ()
            if lowest >= self.slack_below_n
            else tuple(
                number
                for number, tension in enumerate(tensions_n, start=1)
                if tension < self.slack_below_n
            )
        )

    def _problem(self, tensions_n: Sequence[float]) -> SampleError:
        low, high = self._range_n or PLAUSIBLE_N
        cable, tension = next(
            (number, tension)
            for number, tension in enumerate(tensions_n, start=1)
            if not low < tension < high
        )
        reading = f"effort of cable_{cable} is {tension:g} N"
        if not isfinite(tension):
            return SampleError(ProblemKind.NOT_FINITE, f"{reading}; it must be a finite number")
        if self._range_n is None:
            return SampleError(
                ProblemKind.IMPLAUSIBLE,
                f"{reading}; no cable of such an arm is outside {low:g} … {high:g} N",
            )
        return SampleError(
            ProblemKind.SATURATED,
            f"{reading}, at the end of the sensors' range {low:g} … {high:g} N; unload the arm",
        )


_STAMPS_KEPT = 2048
_FEWEST = 4
_PERIODS_KEPT, _LEARNT = 9, 3


class SampleClock:
    """Refuses samples that are too old, from the future, or not newer than the one before.

    Publishers that set no stamp (zero) are let through: their samples count as taken on arrival.
    """

    def __init__(self, stale_after_s: float) -> None:
        self.stale_after_s = stale_after_s
        self._last_ns = 0
        self._taken = 0
        self._stamps_ns: deque[int] = deque(maxlen=_STAMPS_KEPT)
        self._periods_ns: deque[float] = deque(maxlen=_PERIODS_KEPT)
        self._soonest = (0, 0)

    def age_s(self, stamp_ns: int, now_ns: int) -> float:
        """Age of a sample, s.

        Raises:
            SampleError: the stamp cannot be that of a present sample.
        """
        if stamp_ns == 0:
            return 0.0
        age_s = (now_ns - stamp_ns) * 1e-9
        if abs(age_s) > self.stale_after_s:
            raise SampleError(ProblemKind.CLOCK, self._clock_message(age_s))
        if 0 <= self._last_ns - stamp_ns < self.stale_after_s * 1e9:
            raise SampleError(
                ProblemKind.CLOCK,
                f"header.stamp lies {(self._last_ns - stamp_ns) * 1e-9:.6f} s before that of the "
                "last sample; stamps must ascend (is there more than one publisher?)",
            )
        self._last_ns = stamp_ns
        self._stamps_ns.append(stamp_ns)
        self._taken += 1
        return age_s

    def missing_since_last_report(self) -> int:
        """How many samples lack, by the usual period and the stamps of those that came.

        A stamp may be late, by the jitter of who sets it, but never early: from the sample that
        lies soonest in one report to that of the next is counted, so that what is late now is not
        taken for lost. The first three reports, also after a silence, learn the period.
        """
        stamps = np.array(self._stamps_ns, dtype=np.int64)
        self._stamps_ns.clear()
        if len(stamps) < _FEWEST:
            self._periods_ns.clear()
            self._soonest = (0, 0)
            return 0
        first = self._taken - len(stamps)
        due_ns = np.arange(len(stamps)) * self._period_ns(stamps)
        at = int(np.argmin(stamps - stamps[0] - due_ns))
        (before_number, before_ns), self._soonest = self._soonest, (first + at, int(stamps[at]))
        if not before_ns:
            return 0
        count, elapsed_ns = first + at - before_number, int(stamps[at]) - before_ns
        self._periods_ns.append(elapsed_ns / count)
        if len(self._periods_ns) < _LEARNT:
            return 0
        return max(0, round(elapsed_ns / self._period_ns(stamps)) - count)

    def _period_ns(self, stamps_ns: NDArray[np.int64]) -> float:
        if self._periods_ns:
            return float(np.median(self._periods_ns))
        return float(stamps_ns[-1] - stamps_ns[0]) / (len(stamps_ns) - 1)

    def _clock_message(self, age_s: float) -> str:
        where = "old" if age_s > 0 else "ahead of this machine's clock"
        return (
            f"header.stamp is {abs(age_s):.3f} s {where}; at most {self.stale_after_s:g} s is "
            "taken (synchronise the clocks; for a replay set use_sim_time)"
        )


class InputHealth:
    """Counts samples between reports; totals go on."""

    def __init__(self, now_s: float) -> None:
        self._report_s = now_s
        self._arrived = 0
        self._oldest_s = 0.0
        self._refused: Counter[ProblemKind] = Counter()
        self._last_problem = ""
        self._total_missing = 0
        self._total_refused = 0
        self._last_arrival_s = now_s
        self._received = False

    def arrived(self, now_s: float) -> None:
        """A message came, whatever is in it."""
        self._arrived += 1
        self._received = True
        self._last_arrival_s = now_s

    def aged(self, age_s: float) -> None:
        """The age of a sample that was taken."""
        self._oldest_s = max(self._oldest_s, age_s)

    def refused(self, problem: SampleError) -> None:
        """A sample was of no use."""
        self._refused[problem.kind] += 1
        self._last_problem = str(problem)
        self._total_refused += 1

    def silence_s(self, now_s: float) -> float:
        """Time since the last message, or since the start before the first."""
        return now_s - self._last_arrival_s

    def status(
        self, now_s: float, stale_after_s: float, missing: int, publisher_count: int
    ) -> Status:
        """The report of the time since the last one.

        Args:
            now_s: monotonic time.
            stale_after_s: silence from then on counts as stale.
            missing: samples that stamps or the middleware say were lost since the last report.
            publisher_count: publishers on the topic.
        """
        self._total_missing += missing
        rate = self._arrived / max(now_s - self._report_s, 1e-9)
        level, message = self._verdict(now_s, stale_after_s, missing, publisher_count)
        values = {
            "rate (Hz)": f"{rate:.1f}",
            "largest age (s)": f"{self._oldest_s:.4f}",
            "dropped": str(missing),
            "dropped in all": str(self._total_missing),
            "refused": str(sum(self._refused.values())),
            "refused in all": str(self._total_refused),
            "publishers": str(publisher_count),
        }
        values |= {f"refused: {kind.value}": str(count) for kind, count in self._refused.items()}
        if self._last_problem:
            values["last refusal"] = self._last_problem
        self._report_s, self._arrived, self._oldest_s = now_s, 0, 0.0
        self._refused.clear()
        return Status("cable_tensions", level, message, values)

    def _verdict(
        self, now_s: float, stale_after_s: float, missing: int, publisher_count: int
    ) -> tuple[Level, str]:
        silence = self.silence_s(now_s)
        if not self._received:
            return Level.STALE, "no sample received yet"
        if silence > stale_after_s:
            return Level.STALE, f"no sample for {silence:.1f} s"
        if self._refused:
            kinds = ", ".join(f"{count} {kind.value}" for kind, count in self._refused.items())
            return Level.ERROR, f"samples refused: {kinds}"
        if publisher_count > 1:
            return Level.WARN, f"{publisher_count} publishers; one arm has one"
        if missing:
            return Level.WARN, f"{missing} sample{'s' if missing != 1 else ''} dropped"
        return Level.OK, "receiving"
