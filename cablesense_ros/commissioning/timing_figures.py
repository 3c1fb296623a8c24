"""How regularly samples come."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cablesense_ros.commissioning.commissioning_error import CommissioningError
from cablesense_ros.commissioning.tension_series import TensionSeries

FEWEST_SAMPLES = 20
"""With fewer, neither a rate nor noise can be told."""


@dataclass(frozen=True)
class TimingFigures:
    """Of the samples' stamps, within blocks.

    Attributes:
        samples: how many.
        rate_hz: one over the mean interval between samples of which none is missing between.
        jitter_s: by how much 99 of 100 such intervals differ at most from their median.
        lost: samples that are missing between others, by the length of the intervals.
    """

    samples: int
    rate_hz: float
    jitter_s: float
    lost: int

    @property
    def lost_share(self) -> float:
        """Of all that there should be."""
        return self.lost / (self.samples + self.lost)


def timing_figures(series: TensionSeries) -> TimingFigures:
    """The figures of a series.

    Raises:
        CommissioningError: too few samples.
    """
    interval_s = np.diff(series.time_s)[np.diff(series.block) == 0]
    if len(interval_s) < FEWEST_SAMPLES:
        raise CommissioningError(
            f"only {len(series.time_s)} samples; at least {FEWEST_SAMPLES + 1} in one stretch are "
            "needed, better ten seconds"
        )
    usual_s = float(np.median(interval_s))
    whole = interval_s < 1.5 * usual_s
    missing = np.round(interval_s[~whole] / usual_s) - 1.0
    return TimingFigures(
        samples=len(series.time_s),
        rate_hz=1.0 / float(interval_s[whole].mean()),
        jitter_s=float(np.quantile(np.abs(interval_s[whole] - usual_s), 0.99)),
        lost=int(missing.sum()),
    )
