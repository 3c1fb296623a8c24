"""The shapes of networks that are tried."""

from __future__ import annotations

from typing import NamedTuple

DECOUPLED, SHARED_TRUNK, TWO_STAGE = "decoupled", "shared trunk", "two-stage"
ARCHITECTURES = (DECOUPLED, SHARED_TRUNK, TWO_STAGE)
"""By the paper: three networks apart, one trunk for all, contact first and force given it."""


class Shape(NamedTuple):
    """A network: its architecture, and how deep and wide each of its trunks is.

    The first stage of two has a layer less than the second.
    """

    architecture: str
    depth: int
    width: int
