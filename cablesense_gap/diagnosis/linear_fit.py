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
    data: Products, nuisance: int, precision: Array, offset: Array, weight_: float, fold: Indices
) -> Array:
    """(F, K) the coefficients without each of the folds 0 … F - 1.

    The first `nuisance` coefficients are then fitted to all trials, with the others as
    they are: often one trial alone shows a nuisance parameter, and then no fit to the rest
    predicts it.
    """
    gram = data.gram.sum(0)
    moment = data.moment.sum(0)
    t = slice(None, nuisance)
    e = slice(nuisance, None)
    solutions = []
    for k in range(int(fold.max()) + 1):
        fold_gram = data.gram[fold == k].sum(0)
        fold_moment = data.moment[fold == k].sum(0)
        solution = solve(gram - fold_gram, moment - fold_moment, precision, offset, weight_)
        beside = moment[t] - gram[t, e] @ solution[e]
        solution[t] = solve(gram[t, t], beside, precision[t], offset[t], weight_)
        solutions.append(solution)
    return np.array(solutions)


def held_out_squares(
    data: Products, nuisance: int, precision: Array, offset: Array, weight_: float, fold: Indices
) -> Array:
    """(T,) sum of squares left in each trial by the solution without its fold."""
    trial_solutions = fold_solutions(data, nuisance, precision, offset, weight_, fold)[fold]
    explained = (
        (data.gram @ trial_solutions[..., None])[..., 0] - 2.0 * data.moment
    ) * trial_solutions
    return np.maximum(data.square + explained.sum(-1), 0.0)


class Reduced:
    """Held-out mean squares of sets of columns at one weight, nuisance parameters eliminated."""

    def __init__(
        self,
        data: Products,
        nuisance: int,
        base: int,
        precision: Array,
        weight_: float,
        fold: Indices,
    ) -> None:
        """The first `base` columns of `data` are always fitted along.

        The first `nuisance` of them are nuisance parameters.
        """
        self._nuisance_count = nuisance
        self._count = data.count.sum()
        system = []
        moment = []
        form = []
        slope = []
        constant = 0.0
        gram = data.gram.sum(0)
        product = data.moment.sum(0)
        t = slice(None, nuisance)
        b = slice(None, base)
        c = slice(base, None)
        of_nuisance = weight_ * gram[t, t] + np.diag(precision[t])

        def eliminated(g: Array, m: Array) -> tuple[Array, Array]:
            eliminations = np.linalg.solve(
                weight_ * g[b, b] + np.diag(precision[b]),
                weight_ * np.column_stack([m[b], g[b, c]]),
            )
            first = eliminations[:, 0]
            by = eliminations[:, 1:]
            system.append(weight_ * (g[c, c] - g[c, b] @ by) + np.diag(precision[c]))
            moment.append(weight_ * (m[c] - g[c, b] @ first))
            return np.asarray(first), np.asarray(by)

        for k in range(int(fold.max()) + 1):
            fold_gram = data.gram[fold == k].sum(0)
            fold_product = data.moment[fold == k].sum(0)
            first, by = eliminated(gram - fold_gram, product - fold_product)
            across = fold_gram[b, b] @ by - fold_gram[b, c]
            pull = np.column_stack([fold_product[t] - fold_gram[t, b] @ first, -across[t]])
            moved = weight_ * np.linalg.solve(of_nuisance, pull)
            gain = pull.T @ moved
            gain += gain.T - moved.T @ fold_gram[t, t] @ moved
            form.append(fold_gram[c, c] - fold_gram[c, b] @ by + by.T @ across - gain[1:, 1:])
            slope.append(fold_product[c] - by.T @ fold_product[b] + across.T @ first - gain[1:, 0])
            constant += data.square[fold == k].sum() - gain[0, 0]
            constant += first @ (fold_gram[b, b] @ first - 2.0 * fold_product[b])
        self._first, self._by = eliminated(gram, product)
        self._system = np.array(system)
        self._moment = np.array(moment)
        self._form = np.array(form)
        self._slope = np.array(slope)
        self._constant = constant

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
