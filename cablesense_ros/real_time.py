"""Keeping a simulation at real time: how much is due, and what is let go when it falls behind."""

from __future__ import annotations


class RealTimePacer:
    """Says how many time steps are due; never more than `longest_lag_s` of them at once.

    What lies further behind is let go and counted: catching up on it would make the simulation
    fall behind further. Times are of one monotonic clock, s.
    """

    def __init__(self, timestep_s: float, longest_lag_s: float, now_s: float) -> None:
        self._timestep_s = timestep_s
        self._longest_lag_s = longest_lag_s
        self._start_s = now_s
        self._steps = 0
        self._report_s = now_s
        self._report_steps = 0
        self.skipped_s = 0.0

    def steps_due(self, now_s: float) -> int:
        """Steps to do now; they count as done."""
        behind_s = now_s - self._start_s - self._steps * self._timestep_s
        if behind_s > self._longest_lag_s:
            lost_s = behind_s - self._longest_lag_s
            self._start_s += lost_s
            self.skipped_s += lost_s
            behind_s = self._longest_lag_s
        due = max(0, int(behind_s / self._timestep_s + 1e-6))
        self._steps += due
        return due

    def real_time_factor(self, now_s: float) -> float:
        """Simulated time over real time since this was last asked."""
        real_s = now_s - self._report_s
        simulated_s = (self._steps - self._report_steps) * self._timestep_s
        self._report_s, self._report_steps = now_s, self._steps
        return simulated_s / real_s if real_s > 0.0 else 1.0
