"""How the pictures of a report look, and how they get into the page.

Colours are of Okabe and Ito (*Color Universal Design*, 2008); the two that carry the message also
differ in lightness, so that they stay apart in grey print.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

BEFORE, AFTER, FLOOR = "#E69F00", "#0072B2", "#555555"
OTHER, INK, GRID, LOADED = "#9AA3AD", "#1C2126", "#DDE1E6", "#EEF1F4"
WIDTH_IN = 10.2
PNG_DPI = 130
LEAST_N = 1e-4
"""A logarithmic axis has no zero; simulated readings without noise would need it."""

_STYLE: Any = {
    "font.size": 9.5,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.edgecolor": "#8A929B",
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "svg.hashsalt": "cablesense",  # the same inputs give the same bytes
}


@contextmanager
def style() -> Iterator[None]:
    """All drawing of a report happens inside; no window is ever opened."""
    import matplotlib as mpl

    mpl.use("Agg")
    with mpl.rc_context(_STYLE):
        yield


def as_uri(figure: Any, kind: str = "svg") -> str:
    """A drawn figure as the `src` of an image, `svg` or `png`; the figure is closed."""
    return image_uri(image_bytes(figure, kind), kind)


def image_bytes(figure: Any, kind: str, dpi: int = PNG_DPI) -> bytes:
    """A drawn figure as a file, `svg` or `png`; the figure is closed."""
    import matplotlib.pyplot as plt

    buffer = io.BytesIO()
    metadata = {"Date": None} if kind == "svg" else {"Software": None}
    figure.savefig(buffer, format=kind, dpi=dpi, metadata=metadata)
    plt.close(figure)
    return buffer.getvalue()


def image_uri(image: bytes, kind: str) -> str:
    """A file of an image, `svg` or `png`, as the `src` of an image."""
    mime = "image/svg+xml" if kind == "svg" else "image/png"
    return f"data:{mime};base64,{base64.b64encode(image).decode()}"


def plain_log_ticks(axis: Any) -> None:
    """Ticks of a logarithmic axis as 0.1, 0.2, 0.5, 1 … rather than powers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
