"""One measurement: the average of the wrenches that came after the arm had arrived."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FEWEST_SAMPLES = 3


class ForceAverage:
    """Averages forces in a segment's axes over a stretch of stamps, all of the same command.

    A sample without contact counts as no force, so that one that is doubtful weakens the answer.
    Where samples name several segments, those of the most frequent one count.
    """

    def __init__(self, span_s: float, longest_gap_s: float) -> None:
        """`span_s` is averaged over; a gap longer than `longest_gap_s` begins anew."""
        self._span_ns = round(span_s * 1e9)
        self._longest_gap_ns = round(longest_gap_s * 1e9)
        self._samples: list[tuple[int, int, Array]] = []

    def clear(self) -> None:
        """Begin anew."""
        self._samples.clear()

    def add(self, stamp_ns: int, segment: int, force_n: Array) -> None:
        """A sample's force (3,) in its segment's axes; segment 0 is no contact."""
        if self._samples and not 0 < stamp_ns - self._samples[-1][0] <= self._longest_gap_ns:
            self._samples.clear()
        self._samples.append((stamp_ns, segment, force_n))

    @property
    def complete(self) -> bool:
        """Whether the samples span the time."""
        return (
            len(self._samples) >= FEWEST_SAMPLES
            and self._samples[-1][0] - self._samples[0][0] >= self._span_ns
        )

    def take(self) -> tuple[int, Array]:
        """Segment and mean force (3,) in its axes, N; (0, zero) for no contact. Begins anew."""
        touched = Counter(segment for _, segment, _ in self._samples if segment)
        segment = touched.most_common(1)[0][0] if touched else 0
        total = sum(
            (force for _, number, force in self._samples if number == segment and segment),
            start=np.zeros(3),
        )
        mean = total / max(len(self._samples), 1)
        self.clear()
        return segment, np.asarray(mean)
