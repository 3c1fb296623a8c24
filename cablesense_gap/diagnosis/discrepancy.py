"""A flexible model of what is left: how much of it repeats, whatever its cause.

It is fitted to features of the course, and judged on what it was not fitted to. It says that there
is something to be explained, and what that goes with; it knows no physics and names no cause.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.diagnosis.kernel_ridge import held_out, kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Rows = NDArray[np.bool_]

LONG_ROWS = 120
"""Trials longer than this are held out in stretches: no other trial has the poses of a sweep."""
STRETCH_ROWS = 50
TOGETHER = 3
"""Neighbouring rows are averaged: they say the same but for noise."""
_FAR = 3.0
"""Standard deviations beyond which a feature says no more; trials may lie far from all others."""
_FOREMOST = 5


@dataclass(frozen=True)
class Features:
    """What a residual may go with.

    Attributes:
        values: (R, F) in any units.
        names: (F,) for people.
        groups: (F,) which of them belong together, as in `pose` or `load`.
    """

    values: Array
    names: tuple[str, ...]
    groups: tuple[str, ...]


@dataclass(frozen=True)
class Discrepancy:
    """What the flexible model makes of a residual.

    Attributes:
        held_out: (R, C) each stretch predicted by a fit without its fold.
        explained_share: of the mean square beyond the floor; zero or less where nothing repeats.
        by_channel: (C,) the same of each channel; zero in a channel without an excess.
        alone: the share that each group of features explains without the others.
        foremost: features that the residual goes with in a straight line, the foremost first.
    """

    held_out: Array
    explained_share: float
    by_channel: tuple[float, ...]
    alone: Mapping[str, float]
    foremost: tuple[str, ...]


def discrepancy(
    features: Features, residual: Array, trial: Indices, fold: Indices, used: Rows, floor: float
) -> Discrepancy:
    """Explain a residual (R, C) as far as it repeats.

    `trial` (R,) counts from 0, `fold` (T,) says which trials are held out together, `used` (R,)
    which rows count; `floor` is the root mean square of what cannot be explained.

    Raises:
        ValueError: with fewer than three folds none is left to choose on.
    """
    row_fold = _fold_of_rows(trial, fold)
    if row_fold.max() < 2:
        raise ValueError(f"{row_fold.max() + 1} folds of trials; at least 3 are needed")
    part = _parts(trial, row_fold, used)
    x = _averaged(_standardised(features.values, used), part)
    y = _averaged(residual, part)
    first = np.unique(part, return_index=True)[1]
    groups = tuple(dict.fromkeys(features.groups))
    members = {g: x[:, [name == g for name in features.groups]] for g in groups}

    def predicted(by: Sequence[str]) -> Array:
        fitted = held_out(kernel([members[g] for g in by]), y, row_fold[first], used[first])
        return fitted[part]

    def share(prediction: Array, channels: slice = slice(None)) -> float:
        before, after = residual[used], (residual - prediction)[used]
        return _explained(before[:, channels], after[:, channels], floor)

    whole = predicted(groups)
    return Discrepancy(
        held_out=whole,
        explained_share=share(whole),
        by_channel=tuple(share(whole, slice(c, c + 1)) for c in range(residual.shape[1])),
        alone={group: share(predicted([group])) for group in groups},
        foremost=_foremost(features, residual, used),
    )


def _explained(before: Array, after: Array, floor: float) -> float:
    removable = float((before**2).mean()) - floor**2
    if removable <= 0.0:
        return 0.0
    return 1.0 - max(float((after**2).mean()) - floor**2, 0.0) / removable


def _foremost(features: Features, residual: Array, used: Rows) -> tuple[str, ...]:
    x = _standardised(features.values, used)[used]
    y = residual[used] - residual[used].mean(0)
    strength = ((x.T @ y) ** 2).sum(1) / np.maximum((x**2).sum(0), 1e-12)
    order = np.argsort(-strength, kind="stable")[:_FOREMOST]
    return tuple(features.names[k] for k in order if strength[k] > 0.0)


def _standardised(values: Array, used: Rows) -> Array:
    mean, spread = values[used].mean(0), values[used].std(0)
    scaled = (values - mean) / np.where(spread > 1e-12, spread, np.inf)
    return np.clip(scaled, -_FAR, _FAR)


def _fold_of_rows(trial: Indices, fold: Indices) -> Indices:
    """(R,) fold of each row from 0 on; the stretches of a long trial are in folds of their own."""
    fold = np.unique(fold, return_inverse=True)[1]
    found = fold[trial]
    count = int(fold.max()) + 1
    for t in range(len(fold)):
        rows = np.flatnonzero(trial == t)
        if len(rows) > LONG_ROWS:
            stretch = np.arange(len(rows)) // STRETCH_ROWS
            found[rows] = (fold[t] + stretch) % count
    return np.asarray(found)


def _parts(trial: Indices, row_fold: Indices, used: Rows) -> Indices:
    """(R,) number of the few neighbouring rows that a row is averaged with."""
    state = np.column_stack([trial, row_fold, used])
    changes = (np.diff(state, axis=0, prepend=state[:1]) != 0).any(1)
    begin = np.maximum.accumulate(np.where(changes, np.arange(len(state)), 0))
    since = np.arange(len(state)) - begin
    return np.cumsum(changes | ((since % TOGETHER == 0) & (since > 0)))


def _averaged(values: Array, part: Indices) -> Array:
    total = np.zeros((int(part.max()) + 1, values.shape[1]))
    np.add.at(total, part, values)
    return total / np.bincount(part)[:, None]
