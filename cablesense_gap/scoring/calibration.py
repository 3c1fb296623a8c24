"""Whether a stated probability is the share of cases in which it comes true."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

BINS = 10


@dataclass(frozen=True)
class Bin:
    """Cases whose stated probability lies in one tenth of 0 to 1."""

    low: float
    high: float
    count: int
    mean_probability: float
    share_right: float


@dataclass(frozen=True)
class Calibration:
    """Stated probabilities of verdicts against whether they were right.

    Attributes:
        brier: mean square of (probability - outcome); 0 is best, 0.25 is a coin's.
        expected_error: mean over cases of what a bin's mean probability and share differ by.
        bins: those that hold a case.
    """

    brier: float
    expected_error: float
    bins: tuple[Bin, ...]


def calibrate(probability: Sequence[float], right: Sequence[bool]) -> Calibration:
    """Brier score and expected calibration error of stated probabilities, ten even bins.

    G. W. Brier, Monthly Weather Review 78 (1950) 1-3; M. P. Naeini et al., AAAI 2015.
    """
    stated, outcome = np.asarray(probability, dtype=float), np.asarray(right, dtype=float)
    member = np.minimum((stated * BINS).astype(int), BINS - 1)  # 1.0 belongs to the last
    bins = tuple(
        Bin(
            low=k / BINS,
            high=(k + 1) / BINS,
            count=int((member == k).sum()),
            mean_probability=float(stated[member == k].mean()),
            share_right=float(outcome[member == k].mean()),
        )
        for k in np.unique(member).tolist()
    )
    apart = sum(b.count * abs(b.mean_probability - b.share_right) for b in bins)
    return Calibration(
        brier=float(((stated - outcome) ** 2).mean()),
        expected_error=apart / len(stated),
        bins=bins,
    )
