"""Slow drift of the unloaded tensions, watched over the time without contact.

A sensor's zero wanders with temperature, a cable creeps: by little a minute, and by more than a
contact in an hour. Readings of an untouched arm less its unloaded tensions are averaged in
windows. Several windows in a row have the drift in common, whatever its pattern. A swing, or a
touch too light to be a contact, does not last that long.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Final

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import Level, Status
from cablesense_online.state import utc_text

WINDOW_S: Final = 0.5
FEWEST_READINGS: Final = 25
WINDOWS: Final = 3
"""Windows in a row; their smallest deviation is the drift, if all have its sign."""
MOST_TOUCHED: Final = 10
"""This many contacts in a row begin the windows anew; fewer are noise and excluded."""
_LEAST_STDS = 5.0
"""No limit is below this many standard deviations of a window and its tare."""


class DriftWatch:
    """Warns of unloaded tensions that have moved since the tare, and proposes a fresh one.

    Attributes:
        drift_n: (M,) drift over the last windows, N; zero before there were enough.
        limit_n: a warning is due from here on; infinite where nothing is watched.
    """

    def __init__(
        self,
        limit_n: float,
        reading_std_n: float,
        tare_samples: int,
        cable_names: Sequence[str],
        unwatched: str = "",
    ) -> None:
        """`limit_n` 0 watches nothing; nor does a reason `unwatched`."""
        noise_n = reading_std_n * math.sqrt(1.0 / FEWEST_READINGS + 1.0 / tare_samples)
        self._unwatched = unwatched or ("" if limit_n else "switched off (tare_drift_n is 0)")
        self.limit_n = max(limit_n, _LEAST_STDS * noise_n) if not self._unwatched else math.inf
        self._cable_names = cable_names
        self._sum_n = np.zeros(len(cable_names))
        self._means_n: deque[Array] = deque(maxlen=WINDOWS)
        self.tared()

    def tared(self) -> None:
        """Begin anew with another tare, or none."""
        self.interrupt()
        self.drift_n = np.zeros(len(self._cable_names))
        self._since_ns: int | None = None

    def interrupt(self) -> None:
        """Begin new windows, as the arm is touched or moves; the last result is kept."""
        self._count = self._touched = 0
        self._means_n.clear()

    def add(self, difference_n: Array, stamp_ns: int, *, touched: bool) -> None:
        """Add a reading minus the unloaded one (M,), at rest; `touched` as estimated."""
        if touched:
            self._touched += 1
            if self._touched == MOST_TOUCHED:
                self.interrupt()
            return
        self._touched = 0
        if not self._count:
            self._began_ns = stamp_ns
            self._sum_n[:] = 0.0
            if not self._means_n:
                self._first_ns = stamp_ns
        self._sum_n += difference_n
        self._count += 1
        if self._count >= FEWEST_READINGS and abs(stamp_ns - self._began_ns) >= WINDOW_S * 1e9:
            self._close()

    def status(self) -> Status:
        """Which tensions have drifted, and since when."""
        if self._unwatched:
            return Status("drift", Level.OK, f"not watched: {self._unwatched}")
        sizes = zip(self._cable_names, self.drift_n.tolist(), strict=True)
        values = {
            "drift since the tare (N)": ", ".join(f"{name} {n:+.2f}" for name, n in sizes),
            "warned of from (N)": f"{self.limit_n:.2f}",
        }
        if self._since_ns is None:
            return Status("drift", Level.OK, "none of the unloaded tensions seen", values)
        off = np.abs(self.drift_n) >= 0.4 * np.abs(self.drift_n).max()
        names = [name for name, is_off in zip(self._cable_names, off, strict=True) if is_off]
        which = "most cables" if 2 * off.sum() > len(off) else ", ".join(names)
        largest_n = self.drift_n[np.abs(self.drift_n).argmax()]
        return Status(
            "drift",
            Level.WARN,
            f"unloaded tensions have drifted by up to {largest_n:+.2f} N ({which}) from the tare "
            f"since {utc_text(self._since_ns)}: call ~/tare with nothing touching the arm",
            values,
        )

    def _close(self) -> None:
        self._means_n.append(self._sum_n / self._count)
        self._count = 0
        if len(self._means_n) < WINDOWS:
            return
        lowest, highest = np.min(self._means_n, axis=0), np.max(self._means_n, axis=0)
        self.drift_n = np.maximum(lowest, 0.0) + np.minimum(highest, 0.0)
        if np.abs(self.drift_n).max() < self.limit_n:
            self._since_ns = None
        elif self._since_ns is None:
            self._since_ns = self._first_ns
