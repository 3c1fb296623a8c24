"""Linear equations with small positive definite matrices, compiled."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_sim.compiled import compiled


@compiled
def factorise(matrix: Array) -> bool:
    """Cholesky's factor in place of the lower half (K, K); whether that is positive definite."""
    for k in range(len(matrix)):
        for i in range(k, len(matrix)):
            for j in range(k):
                matrix[i, k] -= matrix[i, j] * matrix[k, j]
        if not matrix[k, k] > 0.0:
            return False
        root = np.sqrt(matrix[k, k])
        for i in range(k, len(matrix)):
            matrix[i, k] /= root
    return True


@compiled
def solve(root: Array, rows: Array) -> None:
    """Solve for each of the right-hand sides in rows (B, K), in place, by a factor (K, K)."""
    for row in rows:
        for k in range(len(root)):
            for j in range(k):
                row[k] -= root[k, j] * row[j]
            row[k] /= root[k, k]
        for k in range(len(root) - 1, -1, -1):
            for i in range(k + 1, len(root)):
                row[k] -= root[i, k] * row[i]
            row[k] /= root[k, k]
