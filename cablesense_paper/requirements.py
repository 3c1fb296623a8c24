"""What every report needs beyond the simulation; networks need more, and their studies say so."""

from __future__ import annotations

import importlib

DRAWING = ("jinja2", "matplotlib")


def require_drawing() -> None:
    """Find the packages of page and pictures before anything runs, not after minutes.

    Raises:
        ModuleNotFoundError: one is not installed.
    """
    for name in DRAWING:
        importlib.import_module(name)
