"""Functions that Numba compiles to machine code on their first call.

They serve sequential loops over few numbers, where NumPy's calls cost more than the arithmetic.
The compiled code is stored next to the source (or, if that is read-only, in the user's cache), so
that a machine compiles once; whoever waits for it is told. Numba itself takes a quarter of a
second and some tens of megabytes. A process that calls these functions a few times only is better
off without, and where Numba is not installed they run as Python, some seventy times slower.

A function is compiled anew for every constant among its arguments, and products and inverses of
small matrices take long to compile: pass variables, and write loops.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from typing import Any, TypeVar, cast

_Function = TypeVar("_Function", bound=Callable[..., Any])

ANNOUNCEMENT = (
    "CableSense compiles the statics of arms for this computer, once: up to a minute, then "
    "it goes on …"
)
_OWN = "cablesense_sim"


class _Choice:
    """Whether functions that are defined from now on are compiled in this process."""

    interpreted = False


def leave_interpreted() -> None:
    """Run functions of modules that are imported from now on as Python, in this process.

    For a process that solves few equilibria, and must not stand still for half a minute on a
    fresh machine.
    """
    _Choice.interpreted = True


def compiled(function: _Function) -> _Function:
    """The same function as machine code; it takes floats, integers and arrays, and no keywords."""
    if _Choice.interpreted or not find_spec("numba"):
        return function
    numba = _numba()
    return cast(_Function, numba.njit(cache=True, error_model="numpy")(function))


@cache
def _numba() -> Any:
    """Numba, which says so when it compiles one of our functions for the first time."""
    os.environ.setdefault("NUMBA_OPT", "1")  # compiles in half the time to code that is as fast
    import numba
    from numba.core import event

    class Announcer(event.Listener):
        said = False

        def on_start(self, event: event.Event) -> None:
            if not self.said and event.data["dispatcher"].py_func.__module__.startswith(_OWN):
                self.said = True
                print(ANNOUNCEMENT, file=sys.stderr, flush=True)

        def on_end(self, event: event.Event) -> None:
            """Nothing: what has been waited for goes on."""

    event.register("numba:compile", Announcer())
    return numba
