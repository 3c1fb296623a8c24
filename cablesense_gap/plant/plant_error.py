"""The error of a plant that cannot be built or run."""

from __future__ import annotations

from cablesense_msgs_py.errors import CableSenseError


class PlantError(CableSenseError):
    """A plant that cannot be built, or that finds no rest: says what, where and what is right."""
