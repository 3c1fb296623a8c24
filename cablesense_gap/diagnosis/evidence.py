"""What a linear model of the residual explains, on trials that it was not fitted to.

All is done on the products X'X, X'y and y'y of each trial, so that a fit without some of the
trials costs no more than the solution of a small system.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

CORRELATION = 10.0
"""Neighbouring samples share what no candidate explains: that part counts for as many fewer."""


@dataclass(frozen=True)
class Products:
    """Sums over the rows of each of T trials, for K columns.

    Attributes:
        gram: (T, K, K) X'X.
        moment: (T, K) X'y.
        square: (T,) y'y.
        count: (T,) numbers in y.
    """

    gram: Array
    moment: Array
    square: Array
    count: Array

    def columns(self, chosen: Indices | Sequence[int]) -> Products:
        """Those of some of the columns."""
        at = np.asarray(chosen, dtype=np.int64)
        return Products(self.gram[:, at[:, None], at], self.moment[:, at], self.square, self.count)

    @property
    def mean_square(self) -> float:
        """Of y."""
        return float(self.square.sum() / self.count.sum())


def products(columns: Array, residual: Array, trial: Indices, used: NDArray[np.bool_]) -> Products:
    """Products of columns (K, R, C) and a residual (R, C), by trial 0 … T - 1 of each row (R,)."""
    parts = []
    for t in range(int(trial.max()) + 1):
        rows = (trial == t) & used
        y = residual[rows].ravel()
        x = columns[:, rows].reshape(len(columns), y.size)
        parts.append((x @ x.T, x @ y, y @ y, y.size))
    gram, moment, square, count = (np.array(part) for part in zip(*parts, strict=True))
    return Products(gram, moment, square, count.astype(float))


def weight(mean_square: float, floor: float) -> float:
    """Inverse variance that one number deserves when so much is left unexplained."""
    return 1.0 / (floor**2 + CORRELATION * max(mean_square - floor**2, 0.0))


def solve(gram: Array, moment: Array, precision: Array, offset: Array, weight_: float) -> Array:
    """The coefficients (K,) that are most probable, with priors N(-offset, 1 / precision)."""
    system = weight_ * gram + np.diag(precision)
    return np.asarray(np.linalg.solve(system, weight_ * moment - precision * offset))


def fold_solutions(
    data: Products, precision: Array, offset: Array, weight_: float, fold: Indices
) -> Array:
    """(F, K) the coefficients without each of the folds 0 … F - 1."""
    gram, moment = data.gram.sum(0), data.moment.sum(0)
    return np.array(
        [
            solve(
                gram - data.gram[fold == k].sum(0),
                moment - data.moment[fold == k].sum(0),
                precision,
                offset,
                weight_,
            )
            for k in range(int(fold.max()) + 1)
        ]
    )


def held_out_squares(
    data: Products, precision: Array, offset: Array, weight_: float, fold: Indices
) -> Array:
    """(T,) sum of squares left in each trial by a fit to the trials of the other folds."""
    found = fold_solutions(data, precision, offset, weight_, fold)[fold]
    explained = ((data.gram @ found[..., None])[..., 0] - 2.0 * data.moment) * found
    return np.maximum(data.square + explained.sum(-1), 0.0)
