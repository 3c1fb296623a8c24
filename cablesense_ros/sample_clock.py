"""The age of samples: stamps against this machine's clock and against each other."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from cablesense_ros.sample_error import ProblemKind, SampleError

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
