"""Rows at which an arm has one place to rest in, and only one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SLACK_N = 2.5
MOST_SLACK = 2


def with_one_rest(tensions_n: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(…,) whether at most two cables are slack or about to be, of predicted tensions (…, M).

    With more of them slack an arm has two places to rest in, and which one it takes is chance.
    """
    return np.asarray((tensions_n < SLACK_N).sum(-1) <= MOST_SLACK)
