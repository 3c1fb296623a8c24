"""The unknown error of an inexact model: a smooth part and the rest, each with its own scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array

_SMOOTH_SHARE = 0.5
"""Share of the smooth part in the mean square of an error as it is expected."""


@dataclass(frozen=True)
class TwoParts:
    """Channels of which a smooth part and the rest are scaled, in each fold by itself.

    Attributes:
        rows: of each fold.
        basis: (C, rows, K) of each fold: orthonormal functions, or zero.
        smooth: (C,) factors of the part in the span of these.
        rest: (C,) of each fold, factors of the rest.
    """

    rows: Sequence[NDArray[np.int64]]
    basis: Sequence[Array]
    smooth: Array
    rest: Sequence[Array]

    @staticmethod
    def of(
        columns: Array, residual: Array, error: Array, least: float, fold: NDArray[np.int64]
    ) -> tuple[TwoParts, Array]:
        """The two parts, and the deviation (C,) of the rest, in the units of the residual.

        Args:
            columns: (C, R, K) of the smooth part. Their coefficients are normal with variance one.
            residual: (R, C) of the best hypothesis. Its RMS outside the columns is the deviation.
            error: (C,) RMS that is expected of the model, the largest deviation.
            least: the smallest deviation.
            fold: (R,) of each row, below zero for rows that do not count.

        Directions of the columns that are smaller than the deviation belong to the rest.
        """
        rows = [np.flatnonzero(fold == k) for k in np.unique(fold[fold >= 0])]
        decompositions = [
            np.linalg.svd(columns[:, fold_rows], full_matrices=False)[:2] for fold_rows in rows
        ]
        error, squares_left, free = (
            np.maximum(error, least),
            np.zeros(len(error)),
            np.zeros(len(error)),
        )
        for fold_rows, (functions, size) in zip(rows, decompositions, strict=True):
            large = size > error[:, None]
            on = (functions.swapaxes(-1, -2) @ residual[fold_rows].T[..., None])[..., 0] * large
            squares_left += (residual[fold_rows] ** 2).sum(0) - (on**2).sum(1)
            free += len(fold_rows) - large.sum(1)
        deviation = np.clip(np.sqrt(squares_left / free), least, error)
        smooth = np.sqrt(_SMOOTH_SHARE) * deviation / error
        basis = []
        rest = []
        for functions, size in decompositions:
            large = size > deviation[:, None]
            basis.append(functions * large[:, None])
            count = functions.shape[1]
            dimensions = large.sum(1)
            share = np.where(dimensions > 0, 1.0 - _SMOOTH_SHARE, 1.0)
            rest.append(np.sqrt(share * count / np.maximum(count - dimensions, 1)))
        return TwoParts(rows, basis, smooth, rest), deviation

    def scaled(self, values: Array) -> Array:
        """Values (…, R, C), each part multiplied by its factor."""
        return self._scaled(values, self.smooth, self.rest)

    def restored(self, values: Array) -> Array:
        """The inverse of `scaled`."""
        return self._scaled(values, 1.0 / self.smooth, [1.0 / each for each in self.rest])

    def _scaled(self, values: Array, inside: Array, rest: Sequence[Array]) -> Array:
        rescaled = values.copy()
        for rows, basis, outside in zip(self.rows, self.basis, rest, strict=True):
            row_values = np.moveaxis(values[..., rows, :], -1, -2)[..., None]
            part = (basis @ (basis.swapaxes(-1, -2) @ row_values))[..., 0]
            scaled = row_values[..., 0] * outside[:, None] + part * (inside - outside)[:, None]
            rescaled[..., rows, :] = np.moveaxis(scaled, -1, -2)
        return rescaled
