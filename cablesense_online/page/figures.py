"""The figures on the page: values as text with the digits that are known, and HTML of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

import jinja2

from cablesense_msgs_py.messages import Level
from cablesense_online.page.colours import ESTIMATE_RGB, TENSION_CSS, TRUE_RGB, css, segment_rgb
from cablesense_online.page.headline import Words
from cablesense_online.page.snapshot import PlaceInterval

GREY = "#8a93a3"
"""Colour of what is not known, and of axes."""
_COLOURS: dict[str, Any] = {
    "grey": GREY,
    "true_css": css(TRUE_RGB),
    "estimate_css": css(ESTIMATE_RGB),
    "tension_css": ", ".join(TENSION_CSS),
    "segment_css": lambda number: css(segment_rgb(number)),
    "level_css": {
        Level.OK: "#00b280",
        Level.WARN: "#f0a832",
        Level.ERROR: "#e8604c",
        Level.STALE: GREY,
    },
}


def newtons_text(force_n: float) -> str:
    """A force without its unit; forces below 10 N have a digit more."""
    return f"{force_n:.{2 if force_n < 9.95 else 1}f}"


def _decimals(low: float, high: float) -> int:
    """The number of decimals, at most two, that leaves one digit of the interval's width.

    Two digits where the first is 1. The ends of an interval of angles may be on both sides of
    360°.
    """
    width = high - low if high >= low else high - low + 360.0
    if width <= 0.0:
        return 2
    power = math.floor(math.log10(width))
    second = width < 2.0 * 10.0**power
    return min(2, max(0, second - power))


def interval_text(low: float, high: float) -> str:
    """`59.33 to 59.38`: both ends with the digits that their distance leaves."""
    digits = _decimals(low, high)
    return f"{low:.{digits}f} to {high:.{digits}f}"


def known_text(value: float, low: float, high: float) -> str:
    """A value with as many digits as its interval has."""
    return f"{value:.{_decimals(low, high)}f}"


def covered_m(region: Sequence[PlaceInterval]) -> float:
    """The length of an interval of places along the arm."""
    return sum(part.high_m - part.low_m for part in region)


def places_text(region: Sequence[PlaceInterval], words: Words) -> str:
    """`52 to 73 mm`, or `121 mm of 2 to 14 mm of 3` where it ends on another link."""
    low_mm = 1e3 * region[0].low_m
    high_mm = 1e3 * region[-1].high_m
    if len(region) == 1:
        return f"{interval_text(low_mm, high_mm)} mm"
    first = words.links[region[0].segment - 1]
    last = words.links[region[-1].segment - 1]
    return f"{low_mm:.0f} mm of {first} to {high_mm:.0f} mm of {last}"


def reading_text(value: float, full_scale: float) -> str:
    """A reading with as many decimals as matter on such a scale."""
    decimals = min(2, max(0, 2 - math.floor(math.log10(full_scale))))
    return (
        f"{value:.{decimals}f}" if abs(value) >= 0.5 * 10.0**-decimals else f"{0.0:.{decimals}f}"
    )


def _number_text(value: float | None, form: str) -> str:
    return "–" if value is None else form % value


def _macros() -> Any:
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    environment.filters.update(newtons=newtons_text, number=_number_text)
    environment.globals.update(_COLOURS, interval=interval_text, known=known_text)
    environment.globals.update(covered=covered_m, places=places_text)
    environment.globals.update(reading=reading_text)
    text = files("cablesense_online.page").joinpath("panel.html").read_text(encoding="utf-8")
    return environment.from_string(text).module


_MACROS = _macros()


def html(what: str, *values: Any) -> str:
    """A part of the panels, by its macro in `panel.html`, of the values that the macro takes."""
    return str(getattr(_MACROS, what)(*values)).strip()
