"""Ridge regression on a kernel, judged on folds that it has not seen.

The kernel adds up, for each group of features, a straight line and bumps of two widths, and for
each two groups a bump in both: additive models learn from fewer trials than one bump in all
features would (Duvenaud, Nickisch and Rasmussen, Additive Gaussian processes, NIPS 2011). Far from
all trials bumps say nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Rows = NDArray[np.bool_]

_WIDTHS = (0.5, 1.5)
"""Of the bumps, in standard deviations of each feature."""
_PAIR_WEIGHT = 0.3
_RIDGES = np.logspace(-3.0, 2.0, 6)


def kernel(groups: Sequence[Array]) -> Array:
    """(R, R) from groups of standardised features, each (R, F)."""
    count = len(groups[0])
    total = np.ones((count, count))
    for x in groups:
        apart = _squared_distance(x) / x.shape[1]
        total += x @ x.T / x.shape[1]
        total += sum(np.exp(-apart / (2.0 * width**2)) for width in _WIDTHS)
    for one, other in combinations(groups, 2):
        apart = (_squared_distance(one) + _squared_distance(other)) / (
            one.shape[1] + other.shape[1]
        )
        total += _PAIR_WEIGHT * np.exp(-apart / 2.0)
    return total


def held_out(kernel_: Array, y: Array, fold: Indices, used: Rows) -> Array:
    """(R, C) each fold 0 … F - 1 predicted by a fit to the used rows (R,) of the others.

    The ridge of each channel is the one that predicts best between these other folds. Where
    nothing does better than zero, zero is predicted.
    """
    count = int(fold.max()) + 1
    left = _left_by_two(kernel_, y, fold, used)
    predicted = np.zeros_like(y)
    for k in range(count):
        others = [j for j in range(count) if j != k]
        errors = np.sum([left[k, j] for j in others], axis=0)
        nothing = (y[used & (fold != k)] ** 2).sum(0)
        ridge = _RIDGES[errors.argmin(0)]
        fitted = _predict(kernel_, y, used & (fold != k), fold == k, ridge)
        predicted[fold == k] = np.where(errors.min(0) < nothing, fitted, 0.0)
    return predicted


def _left_by_two(
    kernel_: Array, y: Array, fold: Indices, used: Rows
) -> dict[tuple[int, int], Array]:
    """By folds (k, j): squares (ridges, C) left in fold j by fits without both."""
    found = {}
    for one, other in combinations(range(int(fold.max()) + 1), 2):
        fit = used & (fold != one) & (fold != other)
        values, vectors = np.linalg.eigh(kernel_[np.ix_(fit, fit)])
        along = vectors.T @ y[fit]
        for k, j in ((one, other), (other, one)):
            rows = used & (fold == j)
            across = kernel_[np.ix_(rows, fit)] @ vectors
            tried = [across @ (along / (values + ridge)[:, None]) for ridge in _RIDGES]
            found[k, j] = np.array([((y[rows] - each) ** 2).sum(0) for each in tried])
    return found


def _predict(kernel_: Array, y: Array, fit: Rows, rows: Rows, ridge: Array) -> Array:
    """(rows, C) with a ridge (C,) for each channel."""
    values, vectors = np.linalg.eigh(kernel_[np.ix_(fit, fit)])
    along = (vectors.T @ y[fit]) / (values[:, None] + ridge)
    return np.asarray(kernel_[np.ix_(rows, fit)] @ vectors @ along)


def _squared_distance(x: Array) -> Array:
    square = (x**2).sum(1)
    return np.maximum(square[:, None] + square - 2.0 * x @ x.T, 0.0)
