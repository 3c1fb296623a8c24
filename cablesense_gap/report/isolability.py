"""A picture of which effects a planned motion tells apart."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cablesense_base.files import write_atomically
from cablesense_gap.report.style import AFTER, INK, ReportError, image_bytes, style

if TYPE_CHECKING:
    from cablesense_gap.robot.isolability import Isolability

_KINDS = ("svg", "png")
_CELL_IN = 0.42
_MARGIN_IN = 2.2
_MOST_FLOORS = 30.0
_DARK_FLOORS = 5.0
"""From which on a cell is so dark that its number is white."""


def write_picture(path: Path, found: Isolability, name: str) -> None:
    """Write a matrix of effects: what each other one leaves of each, in floors, as SVG or PNG.

    Of each pair it has the places where the two are most alike. A cell with a frame is a pair that
    a verdict may confuse.

    Raises:
        ReportError: the file's name has another ending, or its place cannot be written to.
    """
    kind = path.suffix.lower().removeprefix(".")
    if kind not in _KINDS:
        raise ReportError(f"{path}: a picture ends with .svg or .png")
    with style():
        write_atomically(path, _drawn(found, name, kind), ReportError)


def _drawn(found: Isolability, name: str, kind: str) -> bytes:
    import matplotlib.pyplot as plt
    from matplotlib.colors import LinearSegmentedColormap, LogNorm
    from matplotlib.patches import Rectangle

    worst = found.worst()
    confused = found.confused()
    labels = [effect.replace("_", " ") for effect in found.effects]
    size_in = _MARGIN_IN + _CELL_IN * len(labels)
    figure, axes = plt.subplots(figsize=(size_in, size_in), layout="constrained")
    shades = LinearSegmentedColormap.from_list("floors", ["#FFFFFF", AFTER])
    shown = np.clip(worst, 0.1, _MOST_FLOORS)
    axes.imshow(shown, cmap=shades, norm=LogNorm(0.1, _MOST_FLOORS))
    for row, column in np.argwhere(np.isfinite(worst)).tolist():
        floors = worst[row, column]
        text = f"{floors:.0f}" if floors >= 10.0 else f"{floors:.1f}"
        colour = "white" if floors > _DARK_FLOORS else INK
        axes.text(column, row, text, ha="center", va="center", fontsize=7.5, color=colour)
        if confused[row, column]:
            corner = (column - 0.46, row - 0.46)
            axes.add_patch(Rectangle(corner, 0.92, 0.92, fill=False, ec="#D55E00", lw=1.8))
    axes.set_xticks(range(len(labels)), labels, rotation=60, ha="right")
    axes.set_yticks(range(len(labels)), labels)
    axes.set_xlabel("could a verdict name this instead?")
    axes.set_title(f"{name}: what the planned motion tells apart, floors that are left")
    for spine in axes.spines.values():
        spine.set_visible(False)
    return image_bytes(figure, kind)
