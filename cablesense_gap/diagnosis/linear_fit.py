"""Linear fits of a residual, scored on held-out trials.

A fit needs only the products X'X, X'y and y'y of each trial, so a fit without some of the trials
is the solution of a small system. If nuisance parameters b are always fitted and a few other
columns c are chosen among many, b is eliminated once (Schur complement) over the trials outside a
fold:

    b = b₀ - B c,    b₀ = w S X_b'y,    B = w S X_b'X_c,    S = (w X_b'X_b + P_b)⁻¹

The residual sum of squares in the fold is then a quadratic form of c. It stays one when the
nuisance parameters t, a part of b, are fitted to all trials. They move by w (w X_t'X_t + P_t)⁻¹
X_t'r. The first product is over all trials, and r is the residual in the fold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array

Indices = NDArray[np.int64]

CORRELATION = 10.0
"""Samples that share a residual which no candidate explains: they count as one."""


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
        """The products of the chosen ones of the K columns, in this order."""
        indices = np.asarray(chosen, dtype=np.int64)
        return Products(
            self.gram[:, indices[:, None], indices],
            self.moment[:, indices],
            self.square,
            self.count,
        )

    def of_folds(self, fold: Indices) -> Products:
        """The sums of each fold 0 … F - 1 in place of those of trials, whose folds are (T,)."""
        folds = range(int(fold.max()) + 1)
        gram, moment, square, count = (
            np.array([of_trials[fold == k].sum(0) for k in folds])
            for of_trials in (self.gram, self.moment, self.square, self.count)
        )
        return Products(gram, moment, square, count)

    @property
    def mean_square(self) -> float:
        """Mean square of y over all trials, in its unit squared."""
        return float(self.square.sum() / self.count.sum())


def products(
    columns: Array,
    residual: Array,
    trial: Indices,
    used: NDArray[np.bool_],
    known: Array | None = None,
) -> Products:
    """Products of columns (K, R, C) and a residual (R, C), by trial 0 … T - 1 of each row (R,).

    `known` is the Gram matrix (T, J, J) of the first J columns, if they had their products before.
    """
    parts = []
    before = 0 if known is None else known.shape[1]
    for t in range(int(trial.max()) + 1):
        rows = (trial == t) & used
        y = residual[rows].ravel()
        x = columns[:, rows].reshape(len(columns), y.size)
        gram = np.empty(2 * (len(x),))
        if known is not None:
            gram[:before, :before] = known[t]
        gram[before:] = x[before:] @ x.T
        gram[:before, before:] = gram[before:, :before].T
        parts.append((gram, x @ y, y @ y, y.size))
    gram, moment, square, count = (np.array(part) for part in zip(*parts, strict=True))
    return Products(gram, moment, square, count.astype(float))


def weight(mean_square: float, floor: float) -> float:
    """Inverse variance of one number at a mean square residual, part of which is correlated."""
    return 1.0 / (floor**2 + CORRELATION * max(mean_square - floor**2, 0.0))


def solve(gram: Array, moment: Array, precision: Array, offset: Array, weight_: float) -> Array:
    """The coefficients (K,) that are most probable, with priors N(-offset, 1 / precision)."""
    system = weight_ * gram + np.diag(precision)
    return np.asarray(np.linalg.solve(system, weight_ * moment - precision * offset))


def fold_solutions(
    folds: Products, nuisance: int, precision: Array, offset: Array, weight_: float
) -> Array:
    """(F, K) the coefficients without each of the F folds, of which the products are the sums.

    The first `nuisance` coefficients are then fitted to all trials, with the others as
    they are: often one trial alone shows a nuisance parameter, and then no fit to the rest
    predicts it.
    """
    gram = folds.gram.sum(0)
    moment = folds.moment.sum(0)
    t = slice(None, nuisance)
    e = slice(nuisance, None)
    systems = weight_ * (gram - folds.gram) + np.diag(precision)
    pulls = weight_ * (moment - folds.moment) - precision * offset
    solutions = np.linalg.solve(systems, pulls[..., None])[..., 0]
    of_nuisance = weight_ * gram[t, t] + np.diag(precision[t])
    beside = weight_ * (moment[t] - solutions[:, e] @ gram[e, t]) - precision[t] * offset[t]
    solutions[:, t] = np.linalg.solve(of_nuisance, beside.T).T
    return np.asarray(solutions)


def held_out_squares(
    folds: Products, nuisance: int, precision: Array, offset: Array, weight_: float
) -> Array:
    """(F,) sum of squares left in each of the F folds by the solution without it."""
    solutions = fold_solutions(folds, nuisance, precision, offset, weight_)
    explained = ((folds.gram @ solutions[..., None])[..., 0] - 2.0 * folds.moment) * solutions
    return np.maximum(folds.square + explained.sum(-1), 0.0)


class Reduced:
    """Held-out mean squares of sets of columns at one weight, nuisance parameters eliminated."""

    def __init__(
        self, folds: Products, nuisance: int, base: int, precision: Array, weight_: float
    ) -> None:
        """The first `base` columns of `folds`, the sums of each fold, are always fitted along.

        The first `nuisance` of them are nuisance parameters.
        """
        self._nuisance_count = nuisance
        self._count = folds.count.sum()
        t = slice(None, nuisance)
        b = slice(None, base)
        c = slice(base, None)
        of_base = folds.gram[:, b, b]
        of_both = folds.gram[:, b, c]
        of_columns = folds.gram[:, c, c]
        base_moment = folds.moment[:, b, None]
        eliminated = np.linalg.solve(
            weight_ * _without_each(of_base) + np.diag(precision[b]),
            weight_ * _without_each(np.concatenate([base_moment, of_both], axis=2)),
        )
        # (F + 1, B, 1) b₀ and (F + 1, B, C) B: without each fold, and last with all
        first = eliminated[:, :, :1]
        by = eliminated[:, :, 1:]
        self._first = first[-1, :, 0]
        self._by = by[-1]
        crossed = _without_each(of_both).swapaxes(1, 2)
        system = _without_each(of_columns)
        system -= crossed @ by
        system *= weight_
        diagonal = np.arange(len(precision) - base)
        system[:, diagonal, diagonal] += precision[c]
        self._system = system
        self._moment = weight_ * (_without_each(folds.moment[:, c]) - (crossed @ first)[..., 0])
        fold_first = first[:-1]
        fold_by = by[:-1]
        across = of_base @ fold_by - of_both
        remaining = base_moment - of_base @ fold_first
        # (F, J, 1 + C) X_t'r in the fold, and by how much it moves the nuisance parameters
        pull = np.concatenate([remaining[:, t], -across[:, t]], axis=2)
        of_nuisance = weight_ * folds.gram[:, t, t].sum(0) + np.diag(precision[t])
        moved = weight_ * np.linalg.solve(of_nuisance, pull)
        beyond = pull - folds.gram[:, t, t] @ moved
        gain = pull.swapaxes(1, 2) @ moved + moved.swapaxes(1, 2) @ beyond
        form = of_columns - of_both.swapaxes(1, 2) @ fold_by
        form += fold_by.swapaxes(1, 2) @ across
        form -= gain[:, 1:, 1:]
        self._form = form
        slope = fold_by.swapaxes(1, 2) @ base_moment - across.swapaxes(1, 2) @ fold_first
        self._slope = folds.moment[:, c] - slope[..., 0] - gain[:, 1:, 0]
        explained = (fold_first * (base_moment + remaining)).sum((1, 2))
        self._constant = float((folds.square - gain[:, 0, 0] - explained).sum())

    def left(self, sets: NDArray[np.int64]) -> tuple[Array, Array]:
        """(N,) mean squares that N sets (N, K) of columns leave, counted from behind the base.

        Also (N,) the sums of squares of the nuisance parameters, fitted to all trials.
        """
        system = self._system[:, sets[:, :, None], sets[:, None, :]]
        solved = np.linalg.solve(system, self._moment[:, sets][..., None])[..., 0]
        of_folds = solved[:-1]
        of_all = solved[-1]
        form = self._form[:, sets[:, :, None], sets[:, None, :]]
        pulled = (form @ of_folds[..., None])[..., 0] - 2.0 * self._slope[:, sets]
        square = (of_folds * pulled).sum((0, -1)) + self._constant
        count = self._nuisance_count
        by = np.moveaxis(self._by[:count][:, sets], 0, 1)
        base = self._first[:count] - (by * of_all[:, None]).sum(-1)
        return np.maximum(square, 0.0) / self._count, np.asarray((base**2).sum(-1))


def _without_each(of_folds: Array) -> Array:
    """(F + 1, …) sums over all folds without each one, and last over all, of sums (F, …)."""
    total = of_folds.sum(0)
    return np.concatenate([total - of_folds, total[None]])
