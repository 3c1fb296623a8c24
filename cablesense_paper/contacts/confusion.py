"""Confusion matrices as pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cablesense_paper.palette import BLACK


def draw_confusion(axes: Any, counts: ArrayLike, names: Sequence[str]) -> None:
    """A matrix of counts, true classes down, answered ones across, in percent of each row.

    A cell that never occurred stays empty; one that did says its share to two digits.
    """
    table = np.asarray(counts, dtype=float)
    share = 100.0 * table / np.maximum(table.sum(axis=1, keepdims=True), 1.0)
    axes.imshow(share, cmap="Blues", vmin=0.0, vmax=120.0)
    for row, column in np.argwhere(table > 0):
        value = share[row, column]
        axes.text(
            column, row, shown_share(value), ha="center", va="center", fontsize=7.6,
            color="white" if value > 60.0 else BLACK,
        )  # fmt: skip
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)


def shown_share(percent: float) -> str:
    """`99.9`, `0.05`: never 100 unless it is just that."""
    if percent == 100.0:
        return "100"
    if percent >= 10.0:
        return f"{min(percent, 99.9):.1f}"
    return f"{percent:.1f}" if percent >= 1.0 else f"{percent:.2f}"
