"""Commissioning of tension sensors: check their statistics, and calibrate scale and zero."""

from __future__ import annotations

from cablesense_base import CableSenseError


class CommissioningError(CableSenseError):
    """Unusable input for commissioning; the message names file, row or cable, and the remedy."""
