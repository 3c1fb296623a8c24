"""What moves the arm in a demo."""

from __future__ import annotations

from enum import Enum


class Controller(Enum):
    """Nothing but the person at the page, or a controller."""

    NONE = "none"
    ADMITTANCE = "admittance"
