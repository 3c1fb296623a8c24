"""What a few columns explain on held-out trials, with the tolerances already taken out.

With the tolerances b always fitted along and few other columns c among many, b is eliminated once
(Schur complement), and each set of columns costs no more than a system of its own small size:

    b = b₀ - B c,    b₀ = w S X_b'y,    B = w S X_b'X_c,    S = (w X_b'X_b + P_b)⁻¹

over the trials outside a fold, and what is left in the fold is a quadratic form of c.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.diagnosis.evidence import Array, Indices, Products


class Reduced:
    """Held-out mean squares of sets of columns at one weight of the readings."""

    def __init__(
        self, data: Products, base: int, precision: Array, weight_: float, fold: Indices
    ) -> None:
        """The first `base` columns of `data` are always fitted along."""
        self._count = data.count.sum()
        system, moment, form, slope, constant = [], [], [], [], 0.0
        gram, product = data.gram.sum(0), data.moment.sum(0)
        b, c = slice(None, base), slice(base, None)

        def eliminated(g: Array, m: Array) -> tuple[Array, Array]:
            both = np.linalg.solve(
                weight_ * g[b, b] + np.diag(precision[b]),
                weight_ * np.column_stack([m[b], g[b, c]]),
            )
            first, by = both[:, 0], both[:, 1:]
            system.append(weight_ * (g[c, c] - g[c, b] @ by) + np.diag(precision[c]))
            moment.append(weight_ * (m[c] - g[c, b] @ first))
            return np.asarray(first), np.asarray(by)

        for k in range(int(fold.max()) + 1):
            own, own_product = data.gram[fold == k].sum(0), data.moment[fold == k].sum(0)
            first, by = eliminated(gram - own, product - own_product)
            across = own[b, b] @ by - own[b, c]
            form.append(own[c, c] - own[c, b] @ by + by.T @ across)
            slope.append(own_product[c] - by.T @ own_product[b] + across.T @ first)
            constant += data.square[fold == k].sum()
            constant += first @ (own[b, b] @ first - 2.0 * own_product[b])
        self._first, self._by = eliminated(gram, product)
        self._system, self._moment = np.array(system), np.array(moment)
        self._form, self._slope, self._constant = np.array(form), np.array(slope), constant

    def mean_squares(self, sets: NDArray[np.int64]) -> Array:
        """(N,) left by each of N sets (N, K) of columns, counted from behind the base."""
        found = self._solved(sets)[:-1]
        form = self._form[:, sets[:, :, None], sets[:, None, :]]
        pulled = (form @ found[..., None])[..., 0] - 2.0 * self._slope[:, sets]
        left = (found * pulled).sum((0, -1)) + self._constant
        return np.asarray(np.maximum(left, 0.0) / self._count)

    def strains(self, sets: NDArray[np.int64]) -> Array:
        """(N,) sums of squares of the base beside each of the sets, fitted to all trials."""
        found = self._solved(sets)[-1]
        base = self._first - (np.moveaxis(self._by[:, sets], 0, 1) * found[:, None]).sum(-1)
        return np.asarray((base**2).sum(-1))

    def _solved(self, sets: NDArray[np.int64]) -> Array:
        """(F + 1, N, K) coefficients without each fold, and last with all of them."""
        system = self._system[:, sets[:, :, None], sets[:, None, :]]
        return np.asarray(np.linalg.solve(system, self._moment[:, sets][..., None])[..., 0])
