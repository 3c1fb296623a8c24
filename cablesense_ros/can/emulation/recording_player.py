"""A recording in its own time: which row is due, and which command it came under."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

COMMAND_EVERY_S = 1.0

PAUSE_S = 0.5
"""Between the end of a recording and its next beginning."""


class RecordingPlayer:
    """Gives rows as they become due; times are of one monotonic clock, s.

    Attributes:
        ended: whether the last row was given, and there is no next time.
    """

    def __init__(self, time_s: Array, tensions_n: Array, command_rad: Array, loop: bool) -> None:
        """R rows: `time_s` (R,) ascending, `tensions_n` (R, M), `command_rad` (R, 2N)."""
        self._time_s = time_s - time_s[0]
        self._tensions_n = tensions_n
        self._command_rad = command_rad
        self._loop = loop
        self._row = 0
        self._began_s: float | None = None
        self._told_s = 0.0
        self.ended = False

    def due(self, now_s: float) -> list[tuple[Array, Array | None]]:
        """The rows due since this was last asked: (M,) tensions, and at times their command.

        The command (2N,) comes with the first row of every turn, wherever it changes, and once
        more every `COMMAND_EVERY_S`, for an estimator that was started later.
        """
        if self._began_s is None:
            self._began_s = now_s
        rows = []
        while not self.ended and self._began_s + self._time_s[self._row] <= now_s:
            row = self._row
            command = self._command_rad[row]
            new = row == 0 or (command != self._command_rad[row - 1]).any()
            told = new or now_s - self._told_s >= COMMAND_EVERY_S
            self._told_s = now_s if told else self._told_s
            rows.append((self._tensions_n[row], command if told else None))
            self._row += 1
            if self._row == len(self._time_s):
                self._row = 0
                self._began_s += float(self._time_s[-1]) + PAUSE_S
                self.ended = not self._loop
        return rows
