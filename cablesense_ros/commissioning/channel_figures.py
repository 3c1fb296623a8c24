"""What one sensor's readings say of it: noise, quantisation step, drift, range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WINDOW_S = 1.0
"""Within it what changes by more than a straight line counts as noise."""
WINDOW_SAMPLES = 10
"""A window has at least so many."""
FEWEST_VALUES = 3
"""Different values without which no step can be told from chance."""
STEP_SCATTER = 0.1
"""Values further than this share of a step from whole steps are not on steps."""


@dataclass(frozen=True)
class ChannelFigures:
    """One sensor; none where there were too few readings at rest.

    Attributes:
        cable: its name.
        mean_n: at rest, or of all readings where there was no rest.
        lowest_n, highest_n: of all readings.
        noise_n: standard deviation at rest about a straight line, the median of windows of 1 s.
        step_n: smallest step of the readings; none where they lie on no steps.
        drift_n: what a straight line through the readings at rest rises by from first to last.
    """

    cable: str
    mean_n: float
    lowest_n: float
    highest_n: float
    noise_n: float | None
    step_n: float | None
    drift_n: float | None


def channel_figures(
    cable: str, time_s: Array, readings_n: Array, at_rest: NDArray[np.bool_]
) -> ChannelFigures:
    """The figures of (R,) readings at ascending times, of which some were taken at rest."""
    rest_n, rest_s = readings_n[at_rest], time_s[at_rest]
    enough = len(rest_n) >= WINDOW_SAMPLES
    return ChannelFigures(
        cable=cable,
        mean_n=float((rest_n if enough else readings_n).mean()),
        lowest_n=float(readings_n.min()),
        highest_n=float(readings_n.max()),
        noise_n=_noise_n(rest_s, rest_n),
        step_n=quantisation_step_n(readings_n),
        drift_n=_drift_n(rest_s, rest_n) if enough else None,
    )


def quantisation_step_n(readings_n: Array) -> float | None:
    """The step on whose multiples readings (R,) lie, from any start; none if they lie on none.

    It can be a multiple of the true step where no two neighbouring values occur.
    """
    values = np.unique(readings_n)
    if len(values) < FEWEST_VALUES:
        return None
    gaps = np.diff(values)
    whole = np.round(gaps / gaps.min())  # gap by gap, so that rounded values do not add up
    steps = np.concatenate([[0.0], np.cumsum(whole)])
    step_n = float(np.polyfit(steps, values, 1)[0])
    scatter = np.abs(gaps / step_n - whole)
    return step_n if float(scatter.max()) < STEP_SCATTER else None


def _noise_n(time_s: Array, readings_n: Array) -> float | None:
    deviations_n = []
    start = 0
    while start + WINDOW_SAMPLES <= len(time_s):
        end = int(np.searchsorted(time_s, time_s[start] + WINDOW_S))
        end = max(end, start + WINDOW_SAMPLES)
        if end > len(time_s):
            break
        window_n = readings_n[start:end]
        error_n = window_n - _line(time_s[start:end], window_n)
        deviations_n.append(float(np.sqrt((error_n**2).sum() / (len(window_n) - 2))))
        start = end
    return float(np.median(deviations_n)) if deviations_n else None


def _drift_n(time_s: Array, readings_n: Array) -> float:
    line = _line(time_s, readings_n)
    return float(line[-1] - line[0])


def _line(time_s: Array, readings_n: Array) -> Array:
    since_s = time_s - time_s.mean()
    slope = float((since_s * readings_n).sum() / (since_s**2).sum())
    return np.asarray(readings_n.mean() + slope * since_s, dtype=np.float64)
