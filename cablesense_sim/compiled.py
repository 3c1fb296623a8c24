"""Functions that Numba compiles to machine code on their first call; small linear equations.

They serve sequential loops over few numbers, where NumPy's calls cost more than the arithmetic.
The compiled code is stored next to the source (or, if that is read-only, in the user's cache), so
that a machine compiles once. Import it late: Numba takes a quarter of a second.

A function is compiled anew for every constant among its arguments, and products and inverses of
small matrices take long to compile: pass variables, and write loops.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, TypeVar, cast

os.environ.setdefault("NUMBA_OPT", "1")  # compiles in half the time to code that is as fast

import numba
import numpy as np

from cablesense_base import Array

_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(function: _Function) -> _Function:
    """The same function as machine code; it takes floats, integers and arrays, and no keywords."""
    return cast(_Function, numba.njit(cache=True, error_model="numpy")(function))


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
