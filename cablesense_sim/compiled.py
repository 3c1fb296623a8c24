"""Functions of numbers and arrays that Numba compiles to machine code on their first call.

They serve sequential loops over few numbers, where NumPy's calls cost more than the arithmetic.
The compiled code is stored next to the source (or, if that is read-only, in the user's cache), so
that a machine compiles once. Import it late: Numba takes a quarter of a second.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(function: _Function) -> _Function:
    """The same function as machine code; it takes floats, integers and arrays, and no keywords."""
    return cast(_Function, numba.njit(cache=True, error_model="numpy")(function))
