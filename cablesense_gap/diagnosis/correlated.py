"""Readings whose deviations are alike from row to row, made independent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array


@dataclass(frozen=True)
class Correlated:
    """Deviations that are sums of some columns, beside independent ones; in each fold others.

    Attributes:
        rows: of each fold.
        basis: (C, rows, K) of each fold, orthonormal.
        shrunk: (C, K) of each fold: the share by which whitening makes a component smaller.
    """

    rows: Sequence[NDArray[np.int64]]
    basis: Sequence[Array]
    shrunk: Sequence[Array]

    @staticmethod
    def of(columns: Array, deviation: Array, fold: NDArray[np.int64]) -> Correlated:
        """Columns (C, R, K) with normal coefficients of variance one, beside deviations (R, C).

        `fold` (R,) is that of each row, below zero for rows that do not count.
        """
        relative = columns / deviation.T[:, :, None]
        rows = [np.flatnonzero(fold == k) for k in np.unique(fold[fold >= 0])]
        parts = [np.linalg.svd(relative[:, own], full_matrices=False)[:2] for own in rows]
        shrunk = [1.0 - 1.0 / np.sqrt(1.0 + size**2) for _, size in parts]
        return Correlated(rows, [basis for basis, _ in parts], shrunk)

    def whitened(self, values: Array) -> Array:
        """Values (…, R, C) in units of the independent deviations, with all of them so."""
        return self._scaled(values, [-each for each in self.shrunk])

    def coloured(self, values: Array) -> Array:
        """The inverse of `whitened`."""
        return self._scaled(values, [each / (1.0 - each) for each in self.shrunk])

    def _scaled(self, values: Array, by: Sequence[Array]) -> Array:
        found = values.copy()
        for rows, basis, share in zip(self.rows, self.basis, by, strict=True):
            own = np.moveaxis(values[..., rows, :], -1, -2)[..., None]
            parts = basis.swapaxes(-1, -2) @ own * share[..., None]
            found[..., rows, :] += np.moveaxis((basis @ parts)[..., 0], -1, -2)
        return found
