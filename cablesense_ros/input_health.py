"""What came in since the last report: rate, age, missing and refused samples."""

from __future__ import annotations

from collections import Counter

from cablesense_msgs_py.diagnostics import Level, Status
from cablesense_ros.sample_error import ProblemKind, SampleError


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
