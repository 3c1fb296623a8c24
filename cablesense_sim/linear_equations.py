"""Small linear equations, compiled: factors, solutions with a factor, and any matrix at once."""

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


@compiled
def eliminate(matrix: Array, right: Array) -> Array:
    """The solution (K,) for any matrix (K, K): Gauss's elimination with partial pivoting."""
    rows = matrix.copy()
    solution = right.copy()
    count = len(solution)
    for k in range(count):
        pivot = k + int(np.argmax(np.abs(rows[k:, k])))
        for j in range(count):
            rows[k, j], rows[pivot, j] = rows[pivot, j], rows[k, j]
        solution[k], solution[pivot] = solution[pivot], solution[k]
        for i in range(k + 1, count):
            part = rows[i, k] / rows[k, k]
            for j in range(k + 1, count):
                rows[i, j] -= part * rows[k, j]
            solution[i] -= part * solution[k]
    for k in range(count - 1, -1, -1):
        for j in range(k + 1, count):
            solution[k] -= rows[k, j] * solution[j]
        solution[k] /= rows[k, k]
    return solution
