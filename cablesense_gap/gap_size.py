"""How large the gap is before and after, and how sure that is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.verdict import Gap, removed_fraction

Array = NDArray[np.float64]

_DRAWS = 2000


def gap_size(before_n: Array, after_n: Array, trial: NDArray[np.int64], floor_n: float) -> Gap:
    """Sizes over residuals (R, M) before and after, with a bootstrap over trials (R,).

    The floor is that of the sensors; what a workshop leaves is in the amended arm's own file.
    """
    trial = np.unique(trial, return_inverse=True)[1]  # a draw of empty trials has no size
    per_trial = [np.bincount(trial, (residual**2).sum(-1)) for residual in (before_n, after_n)]
    count = np.bincount(trial) * before_n.shape[1]
    rng = np.random.default_rng(0)
    drawn = rng.integers(0, len(count), (_DRAWS, len(count)))
    numbers = count[drawn].sum(-1)
    sizes = [np.sqrt(squares[drawn].sum(-1) / numbers) for squares in per_trial]
    fractions = [
        removed_fraction(before, after, floor_n) for before, after in zip(*sizes, strict=True)
    ]
    low, high = np.quantile(fractions, [0.025, 0.975])
    whole_before, whole_after = (
        float(np.sqrt(squares.sum() / count.sum())) for squares in per_trial
    )
    return Gap(
        before_n=whole_before,
        after_n=whole_after,
        floor_n=floor_n,
        removed_fraction=removed_fraction(whole_before, whole_after, floor_n),
        ci95=(float(low), float(high)),
        by_cable_n=tuple(float(v) for v in np.sqrt((before_n**2).mean(0))),
    )


def rmse_interval_n(squares: Array, count: Array) -> tuple[float, float]:
    """95 % interval of the root mean square of squares (T,) of trials, by bootstrap over them."""
    squares, count = squares[count > 0], count[count > 0]
    rng = np.random.default_rng(0)
    drawn = rng.integers(0, len(count), (_DRAWS, len(count)))
    sizes = np.sqrt(squares[drawn].sum(-1) / count[drawn].sum(-1))
    low, high = np.quantile(sizes, [0.025, 0.975])
    return float(low), float(high)
