"""Bus timestamps to this machine's clock."""

from __future__ import annotations

from math import isfinite

SAME_CLOCK_S = 0.05
"""Timestamps that lag this machine's clock by no more are of that clock, as SocketCAN's are."""

DRIFT = 200e-6
"""The most by which two quartz clocks drift apart, with a margin."""

JUMP_S = 2.0
"""A lag that changes by more than this at once is a clock that was set, not a busy machine."""


class BusClock:
    """Gives every frame's time by this machine's clock.

    Adapters stamp by this machine's clock, or by their own, which starts when they do. From the
    latter the smallest lag of arrival behind stamp is taken off: it is the clocks' distance plus
    the shortest way, and follows their drift. Frames without a usable stamp count from arrival.
    """

    def __init__(self) -> None:
        self._lag_s: float | None = None
        self._last_now_s = 0.0

    def time_s(self, stamp_s: float, now_s: float) -> float:
        """The frame's time, s since the epoch.

        Args:
            stamp_s: as the bus interface gives it.
            now_s: of its arrival, by this machine's clock, s since the epoch.
        """
        if not isfinite(stamp_s) or stamp_s <= 0.0:
            return now_s
        lag_s = now_s - stamp_s
        known_s = self._lag_s
        if known_s is None or lag_s - known_s > JUMP_S:
            self._lag_s = lag_s
        else:
            self._lag_s = min(lag_s, known_s + DRIFT * max(0.0, now_s - self._last_now_s))
        self._last_now_s = now_s
        same_clock = 0.0 <= self._lag_s <= SAME_CLOCK_S
        return stamp_s if same_clock else stamp_s + self._lag_s

    def restart(self) -> None:
        """The interface was opened again, and its clock may have started anew."""
        self._lag_s = None
