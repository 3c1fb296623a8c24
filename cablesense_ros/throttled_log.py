"""Warnings about bad input, at most one a second of each kind, saying how many were held back."""

from __future__ import annotations

from collections.abc import Callable

PERIOD_S = 1.0


class ThrottledLog:
    """Passes on the first message of a kind and then at most one per `PERIOD_S`."""

    def __init__(self, log: Callable[[str], object], now_s: Callable[[], float]) -> None:
        """`log` takes a line; `now_s` is a monotonic clock in s."""
        self._log = log
        self._now_s = now_s
        self._last_s: dict[str, float] = {}
        self._held_back: dict[str, int] = {}

    def __call__(self, kind: str, message: str) -> None:
        """Log `message`, unless one of its `kind` was logged less than a period ago."""
        now = self._now_s()
        if now - self._last_s.get(kind, float("-inf")) < PERIOD_S:
            self._held_back[kind] = self._held_back.get(kind, 0) + 1
            return
        self._last_s[kind] = now
        held_back = self._held_back.pop(kind, 0)
        self._log(f"{message} ({held_back} more like this)" if held_back else message)
