"""The dark style that the demo's pictures share."""

from __future__ import annotations

from typing import Any

GROUND, INK, DIM, GRID = "#14171d", "#e8ebf0", "#9aa3b2", "#2c323c"
DPI = 110

STYLE: Any = {
    "figure.facecolor": GROUND,
    "axes.facecolor": GROUND,
    "savefig.facecolor": GROUND,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": GRID,
    "xtick.color": DIM,
    "ytick.color": DIM,
    "grid.color": GRID,
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
}
"""For `matplotlib.pyplot.rc_context`."""
