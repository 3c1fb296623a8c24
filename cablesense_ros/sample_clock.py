"""The age of samples: stamps against this machine's clock and against each other."""

from __future__ import annotations

from collections import deque

import numpy as np

from cablesense_ros.sample_error import ProblemKind, SampleError

_STAMPS_KEPT = 2048
_LONGEST_OF_USUAL = 1.5


class SampleClock:
    """Refuses samples that are too old, from the future, or not newer than the one before.

    Publishers that set no stamp (zero) are let through: their samples count as taken on arrival.
    """

    def __init__(self, stale_after_s: float) -> None:
        self.stale_after_s = stale_after_s
        self._last_ns = 0
        self._stamps_ns: deque[int] = deque(maxlen=_STAMPS_KEPT)

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
        return age_s

    def missing_since_last_report(self) -> int:
        """How many samples lack, by the usual period between the stamps of those that came."""
        stamps = np.array(self._stamps_ns, dtype=np.int64)
        if self._stamps_ns:
            last = self._stamps_ns[-1]
            self._stamps_ns.clear()
            self._stamps_ns.append(last)
        if len(stamps) < 4:
            return 0
        gaps = np.diff(stamps)
        period = gaps[gaps <= _LONGEST_OF_USUAL * np.median(gaps)].mean()
        return max(0, round(float(gaps.sum() / period)) - len(gaps))

    def _clock_message(self, age_s: float) -> str:
        where = "old" if age_s > 0 else "ahead of this machine's clock"
        return (
            f"header.stamp is {abs(age_s):.3f} s {where}; at most {self.stale_after_s:g} s is "
            "taken (synchronise the clocks; for a replay set use_sim_time)"
        )
