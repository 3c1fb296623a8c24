"""The common style of self-contained pages: template, pictures and numbers.

Colours are of Okabe and Ito (*Color Universal Design*, 2008); the two that carry the message also
differ in lightness, so that they differ in grey print too.
"""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import resources
from types import MappingProxyType
from typing import Any

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_gap.verdict import FittedNumber, listed

BEFORE = "#E69F00"
AFTER = "#0072B2"
FLOOR = "#555555"
OTHER = "#9AA3AD"
INK = "#1C2126"
GRID = "#DDE1E6"
LOADED = "#EEF1F4"
WIDTH_IN = 10.2
"""Of a picture over the whole page, inches."""
PNG_DPI = 130
"""Dots per inch of a picture as PNG: 1,300 pixels over the whole page."""
_MOST_POINTS = 3000
"""More than a picture has columns of pixels."""

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


Line = tuple[Array, str, float, str]
"""Values (R,), colour, width and name."""


def draw_lines(panel: Any, time_s: Array, lines: Sequence[Line]) -> None:
    """Lines over time (R,); of long recordings their envelopes."""
    for values, colour, width, label in lines:
        at_s, drawn = _envelope(time_s, values)
        panel.plot(at_s, drawn, color=colour, lw=width, label=label)
    panel.grid(axis="y")


def _envelope(time_s: Array, values: Array) -> tuple[Array, Array]:
    if len(time_s) <= _MOST_POINTS:
        return time_s, values
    edges = np.linspace(0, len(time_s), _MOST_POINTS // 2 + 1).astype(int)[:-1]
    low = np.fmin.reduceat(values, edges)
    high = np.fmax.reduceat(values, edges)
    return np.repeat(time_s[edges], 2), np.stack([low, high], axis=-1).ravel()


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
    """A file of an image, `svg`, `png` or `webp`, as the `src` of an image."""
    mime = "image/svg+xml" if kind == "svg" else f"image/{kind}"
    return f"data:{mime};base64,{base64.b64encode(image).decode()}"


class ReportError(CableSenseError):
    """A report that cannot be written: names the place and the reason."""


_SHARED = ("layout.html", "charts.html")


def rendered(
    package: str,
    template: str,
    content: Mapping[str, Any],
    filters: Mapping[str, Callable[..., Any]] = MappingProxyType({}),
) -> str:
    """A package's Jinja template as HTML text; `content` and the common style, `css`, go in.

    The template may extend `layout.html` and import `charts.html`. `filters` are in addition to
    those of sizes and lists.
    """
    from jinja2 import DictLoader, Environment, StrictUndefined

    source = _text(package, template)
    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        loader=DictLoader({name: _text(__package__, name) for name in _SHARED}),
    )
    common = (newtons, size_text, percent, with_interval, listed)
    environment.filters.update({each.__name__: each for each in common}, **filters)
    return environment.from_string(source).render(
        {"css": _text(__package__, "page.css"), **content}
    )


def _text(package: str, name: str) -> str:
    return resources.files(package).joinpath(name).read_text(encoding="utf-8")


def newtons(value: float) -> str:
    """`3.20 N`: hundredths below 10 N, tenths above, no more than a sensor resolves."""
    return f"{value:.2f} N" if abs(value) < 10.0 else f"{value:.1f} N"


def size_text(value: float, unit: str) -> str:
    """A size of a verdict in its unit: newtons, or floors of a robot's channels."""
    if unit == "N":
        return newtons(value)
    return f"{value:.3g} {unit.removesuffix('s') if value == 1.0 else unit}"


def percent(share: float) -> str:
    """`93 %`; never 0 % or 100 % unless it is just that."""
    whole = round(100.0 * share)
    if whole >= 100 and share < 1.0:
        return "> 99 %"
    if whole <= 0 and share > 0.0:
        return "< 1 %"
    return f"{whole} %"


def with_interval(estimate: FittedNumber) -> tuple[str, str]:
    """Value and 95 % interval, to the digits that the interval leaves."""
    low, high = estimate.ci95
    width = high - low
    decimals = 3
    if width > 0.0:
        decimals = min(9, max(0, 1 - math.floor(math.log10(width))))
    elif estimate.value:
        decimals = min(9, max(0, 3 - math.floor(math.log10(abs(estimate.value)))))
    return f"{estimate.value:.{decimals}f}", f"{low:.{decimals}f} to {high:.{decimals}f}"
