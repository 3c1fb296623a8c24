"""Functions of numbers and arrays that Numba compiles to machine code on their first call.

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

_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(function: _Function) -> _Function:
    """The same function as machine code; it takes floats, integers and arrays, and no keywords."""
    return cast(_Function, numba.njit(cache=True, error_model="numpy")(function))
