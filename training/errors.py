"""Errors of training, and the check of an option's range."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cablesense_base.errors import CableSenseError


class TrainingError(CableSenseError):
    """A network, setting or dataset that cannot be trained with: says which, and what is right."""


class DatasetError(CableSenseError):
    """A dataset that does not fit: says what is wrong, where, and what would be right."""


def require_within(name: str, value: Any, low: float, high: float, *, whole: bool = False) -> None:
    """Refuse what is not a number, not finite or out of range.

    Raises:
        DatasetError: names the option, its value and its range.
    """
    kinds = (int, np.integer) if whole else (int, float, np.number)
    numeric = isinstance(value, kinds) and not isinstance(value, bool)
    if not numeric or not math.isfinite(value) or not low <= value <= high:
        kind = "a whole number" if whole else "a number"
        raise DatasetError(f"{name} = {value!r}: must be {kind} from {low:,} to {high:,}")
