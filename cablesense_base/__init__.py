"""The base of all packages: the error family, arrays, files from outside, worker pools.

Every error that CableSense raises on purpose derives from `CableSenseError`, so that a command can
turn it into one line and a node into one log message. Each package adds its own next to the code
that raises them: `ArmFileError`, `RecordingError` and so on.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""An array of numbers; docstrings say shapes and units."""


class CableSenseError(Exception):
    """Base of all errors raised on purpose: names the mistake, its place, and the valid values."""


def some_of(names: Sequence[str], most: int = 6) -> str:
    """The first of many names and how many more there are: `a, b and 3 more`."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")
