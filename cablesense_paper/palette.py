"""Colours and line styles of the studies' figures: Okabe and Ito's, with a second cue beside."""

from __future__ import annotations

BLUE, ORANGE, GREEN, VERMILION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PURPLE, SKY, BLACK, GREY = "#CC79A7", "#56B4E9", "#1C2126", "#9AA3AD"
SERIES = (BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY)
DASHES = ("-", "--", "-.", ":")
"""Lines that differ in colour differ in their dashes too, for grey print."""
