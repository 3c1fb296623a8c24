"""A flexible model of the residual: how much of it repeats, whatever its cause.

Kernel ridge regression on features of the arm's motion and load, judged on held-out folds. It
knows no physics and names no cause. The kernel is a sum: for each group of features a linear term
and bumps of two widths, and for each two groups a bump in both. Additive models learn from fewer
trials than one bump in all features (Duvenaud, Nickisch and Rasmussen, Additive Gaussian
processes, NIPS 2011). Far from all trials, bumps predict nothing.

scikit-learn's KernelRidge solves again for each ridge. Here one eigendecomposition serves all
ridges, and each channel has its own, chosen on the other folds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array

_RIDGES = np.logspace(-3.0, 2.0, 6)
"""They range from hardly any smoothing to hardly any fit, for standardised features."""

Indices = NDArray[np.int64]
Rows = NDArray[np.bool_]


def kernel(groups: Sequence[Array]) -> Array:
    """(R, R) from groups of standardised features, each (R, F).

    Widths are in standard deviations. Bumps in two groups weigh less: they are rarely needed.
    """
    count = len(groups[0])
    total = np.ones((count, count))
    for x in groups:
        apart = _squared_distance(x) / x.shape[1]
        total += x @ x.T / x.shape[1]
        total += sum(np.exp(-apart / (2.0 * width**2)) for width in (0.5, 1.5))
    for one, other in combinations(groups, 2):
        apart = (_squared_distance(one) + _squared_distance(other)) / (
            one.shape[1] + other.shape[1]
        )
        total += 0.3 * np.exp(-apart / 2.0)
    return total


def held_out(kernel_: Array, y: Array, fold: Indices, used: Rows) -> Array:
    """(R, C) each fold 0 … F - 1 predicted by a fit to the used rows (R,) of the others.

    Each channel has the ridge that predicts best among these other folds, and the prediction zero
    if no ridge is better than that.
    """
    count = int(fold.max()) + 1
    left = _left_by_two(kernel_, y, fold, used)
    predicted = np.zeros_like(y)
    for k in range(count):
        errors = np.sum([left[k, j] for j in range(count) if j != k], axis=0)
        nothing = (y[used & (fold != k)] ** 2).sum(0)
        fit = used & (fold != k)
        values, vectors = np.linalg.eigh(kernel_[np.ix_(fit, fit)])
        along = (vectors.T @ y[fit]) / (values[:, None] + _RIDGES[errors.argmin(0)])
        fitted = kernel_[np.ix_(fold == k, fit)] @ vectors @ along
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


def _squared_distance(x: Array) -> Array:
    square = (x**2).sum(1)
    return np.maximum(square[:, None] + square - 2.0 * x @ x.T, 0.0)


@dataclass(frozen=True)
class Features:
    """Possible causes of a residual: values (R, F) in any units, names (F,) and groups (F,).

    Groups say which features belong together, as in `pose` or `load`.
    """

    values: Array
    names: tuple[str, ...]
    groups: tuple[str, ...]


@dataclass(frozen=True)
class Discrepancy:
    """The part of a residual that the flexible model explains.

    Attributes:
        held_out: (R, C) each stretch predicted by a fit without its fold.
        explained_share: of the mean square beyond the floor; zero or less where nothing repeats.
        alone: the share that each group of features explains without the others.
        foremost: the feature with the strongest linear relation to the residual.
    """

    held_out: Array
    explained_share: float
    alone: Mapping[str, float]
    foremost: str


def discrepancy(
    features: Features, residual: Array, trial: Indices, fold: Indices, used: Rows, floor: float
) -> Discrepancy:
    """Explain a residual (R, C) as far as it repeats.

    `trial` (R,) counts from 0, `fold` (T,) says which trials are held out together, `used` (R,)
    which rows count; `floor` is the root mean square of what cannot be explained.

    Raises:
        ValueError: with fewer than three folds none is left to choose on.
    """
    row_fold = _fold_of_rows(trial, fold)
    if row_fold.max() < 2:
        raise ValueError(f"{row_fold.max() + 1} folds of trials; at least 3 are needed")
    part = _parts(trial, row_fold, used)
    x = _averaged(_standardised(features.values, used), part)
    y = _averaged(residual, part)
    first = np.unique(part, return_index=True)[1]
    groups = tuple(dict.fromkeys(features.groups))
    members = {g: x[:, [name == g for name in features.groups]] for g in groups}

    def predicted(by: Sequence[str]) -> Array:
        fitted = held_out(kernel([members[g] for g in by]), y, row_fold[first], used[first])
        return fitted[part]

    def share(prediction: Array) -> float:
        """Share of the mean square beyond the floor."""
        removable = float((residual[used] ** 2).mean()) - floor**2
        left = max(float(((residual - prediction)[used] ** 2).mean()) - floor**2, 0.0)
        return 1.0 - left / removable if removable > 0.0 else 0.0

    whole, every = predicted(groups), _standardised(features.values, used)[used]
    straight = every.T @ (residual[used] - residual[used].mean(0))
    strength = (straight**2).sum(1) / np.maximum((every**2).sum(0), 1e-12)
    return Discrepancy(
        held_out=whole,
        explained_share=share(whole),
        alone={group: share(predicted([group])) for group in groups},
        foremost=features.names[int(strength.argmax())],
    )


def _standardised(values: Array, used: Rows) -> Array:
    mean, spread = values[used].mean(0), values[used].std(0)
    scaled = (values - mean) / np.where(spread > 1e-12, spread, np.inf)
    return np.clip(scaled, -3.0, 3.0)  # a trial may be far from all others


def _fold_of_rows(trial: Indices, fold: Indices) -> Indices:
    """(R,) fold of each row from 0 on.

    A trial of more than 120 rows is held out in stretches of 50: no other trial has the poses of a
    sweep.
    """
    fold = np.unique(fold, return_inverse=True)[1]
    found = fold[trial]
    count = int(fold.max()) + 1
    for t in range(len(fold)):
        rows = np.flatnonzero(trial == t)
        if len(rows) > 120:
            stretch = np.arange(len(rows)) // 50
            found[rows] = (fold[t] + stretch) % count
    return np.asarray(found)


def _parts(trial: Indices, row_fold: Indices, used: Rows) -> Indices:
    """(R,) part of each row. Rows of a part are averaged: they differ by noise alone."""
    state = np.column_stack([trial, row_fold, used])
    changes = (np.diff(state, axis=0, prepend=state[:1]) != 0).any(1)
    begin = np.maximum.accumulate(np.where(changes, np.arange(len(state)), 0))
    since = np.arange(len(state)) - begin
    return np.cumsum(changes | ((since % 3 == 0) & (since > 0)))


def _averaged(values: Array, part: Indices) -> Array:
    total = np.zeros((int(part.max()) + 1, values.shape[1]))
    np.add.at(total, part, values)
    return total / np.bincount(part)[:, None]
