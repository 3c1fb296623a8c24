"""Two plugs that are exchanged, as the readings of an untouched arm at a known pose show them."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from cablesense_base import Array

_APART_N: Final = 1.0
"""Cables whose unloaded tensions differ by less cannot be distinguished: builds scatter more."""
_LEFT: Final = 0.5
"""An exchange is believed if it leaves at most this share of the deviation from the arm file."""


def exchanged_plugs(measured_n: Array, predicted_n: Array) -> str:
    """The two cables whose exchange explains how readings (M,) differ from unloaded tensions (M,).

    As a sentence; empty where no exchange of two explains most of it.
    """
    before_n2 = float(((measured_n - predicted_n) ** 2).sum())
    apart_n = np.abs(np.subtract.outer(predicted_n, predicted_n))
    # by how much each exchange lowers the sum of squares
    lower_n2 = -2.0 * np.subtract.outer(measured_n, measured_n)
    lower_n2 = np.triu(lower_n2 * np.subtract.outer(predicted_n, predicted_n))
    one, other = np.unravel_index(np.argmax(lower_n2), lower_n2.shape)
    after_n2 = max(before_n2 - float(lower_n2[one, other]), 0.0)
    if apart_n[one, other] < _APART_N or after_n2 > _LEFT**2 * before_n2:
        return ""
    before_n, after_n = (math.sqrt(each / len(measured_n)) for each in (before_n2, after_n2))
    return (
        f"the plugs of cable_{one + 1} and cable_{other + 1} look exchanged: the readings are "
        f"{before_n:.2f} N (RMS) from the arm file's unloaded tensions, and {after_n:.2f} N once "
        "these two are exchanged"
    )
