"""Keeps a flood of frames from becoming a flood of work or of samples."""

from __future__ import annotations

from cablesense_ros.can.fault import FaultKind
from cablesense_ros.can.fault_ledger import FaultLedger

KNOWN_EXCESS = 2.0
"""Frames of the map may come at this many times their rate; what exceeds it is dropped."""

ALLOWANCE_S = 0.5
"""So long a burst may last before it counts: a process that was held up reads its backlog in one
go, and loses none of it."""


class FloodWatch:
    """Admits frames by rate, with two buckets: one for all frames, one for those of the map.

    Unknown frames are cheap and are let by at any rate; once all frames together exceed the limit
    this is noted. Frames of the map beyond twice their rate come from a babbling node; they are
    dropped, so that samples are never given at more than that rate.
    """

    def __init__(self, limit_frames_s: float, known_frames_s: float, ledger: FaultLedger) -> None:
        self._ledger = ledger
        self._all = _Bucket(limit_frames_s)
        self._known = _Bucket(KNOWN_EXCESS * known_frames_s)

    def admit(self, known: bool, now_s: float) -> bool:
        """Whether a frame may be worked on.

        Args:
            known: its id is one of the map.
            now_s: monotonic time of its arrival.
        """
        if not self._all.take(now_s):
            self._ledger.note(
                FaultKind.FLOODED,
                "bus",
                f"more than {self._all.rate:g} frames a second for {ALLOWANCE_S:g} s",
            )
        if not known or self._known.take(now_s):
            return True
        self._ledger.note(
            FaultKind.FLOODED,
            "amplifier",
            f"more than {self._known.rate:g} frames of the map a second for {ALLOWANCE_S:g} s; "
            "the excess is dropped",
        )
        return False


class _Bucket:
    """A token bucket: `rate` tokens a second, at most `ALLOWANCE_S` of them in store."""

    def __init__(self, rate: float) -> None:
        self.rate = rate
        self._most = max(1.0, rate * ALLOWANCE_S)
        self._tokens = self._most
        self._last_s: float | None = None

    def take(self, now_s: float) -> bool:
        if self._last_s is not None:
            self._tokens = min(self._most, self._tokens + (now_s - self._last_s) * self.rate)
        self._last_s = now_s
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True
