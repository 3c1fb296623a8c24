"""Errors of model files and of what they are asked."""

from __future__ import annotations

from cablesense_base import CableSenseError


class ModelFileError(CableSenseError):
    """A model file that does not fit: names its kind and the kind needed."""


class EstimateError(CableSenseError):
    """Inputs that the model cannot take: wrong shape, not finite, or a command that is missing."""
