"""A picture of which effects a planned motion tells apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cablesense_base.files import write_atomically
from cablesense_gap.report.style import BEFORE, INK, ReportError, image_bytes, style
from cablesense_gap.robot.isolability import CONFUSED, Isolability

_KINDS = ("svg", "png")
_CELL_IN = 0.42
_MARGIN_IN = 2.2
_WORTH_SAYING = 0.005
"""Smaller probabilities are a dot."""


def picture_kind(path: Path) -> str:
    """`svg` or `png`, by the ending of a file's name.

    Raises:
        ReportError: it has another one.
    """
    kind = path.suffix.lower().removeprefix(".")
    if kind not in _KINDS:
        raise ReportError(f"{path}: a picture ends with .svg or .png")
    return kind


def write_picture(path: Path, found: Isolability, name: str) -> None:
    """Write a matrix of effects, the true ones by row, as SVG or PNG.

    A cell has the probability of the other effect where the two are weighed against each other, at
    the places where they are most alike: a half if nothing tells them apart. One with a frame is a
    pair that a verdict would have in one group.

    Raises:
        ReportError: the file's name has another ending, or its place cannot be written to.
    """
    kind = picture_kind(path)
    with style():
        write_atomically(path, _drawn(found, name, kind), ReportError)


def _drawn(found: Isolability, name: str, kind: str) -> bytes:
    import matplotlib.pyplot as plt
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.patches import Rectangle

    share = found.worst()
    labels = [effect.replace("_", " ") for effect in found.effects]
    size_in = _MARGIN_IN + _CELL_IN * len(labels)
    figure, axes = plt.subplots(figsize=(size_in, size_in), layout="constrained")
    shades = LinearSegmentedColormap.from_list("shares", ["#FFFFFF", BEFORE])
    axes.imshow(share, cmap=shades, vmin=0.0, vmax=0.5)
    for row, column in np.argwhere(np.isfinite(share)).tolist():
        text = f"{share[row, column]:.0%}" if share[row, column] >= _WORTH_SAYING else "·"
        axes.text(column, row, text, ha="center", va="center", fontsize=7.5)
        if share[row, column] >= CONFUSED:
            corner = (column - 0.46, row - 0.46)
            axes.add_patch(Rectangle(corner, 0.92, 0.92, fill=False, ec=INK, lw=1.4))
    axes.set_xticks(range(len(labels)), labels, rotation=60, ha="right")
    axes.set_yticks(range(len(labels)), labels)
    axes.set_xlabel("could a verdict name this instead? Its probability, of the two")
    axes.set_title(f"{name}: what the planned motion tells apart")
    for spine in axes.spines.values():
        spine.set_visible(False)
    return image_bytes(figure, kind)
