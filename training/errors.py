"""Errors of training, of datasets, of model files and of estimates."""

from __future__ import annotations

from cablesense_base import CableSenseError


class TrainingError(CableSenseError):
    """A network, setting or dataset that cannot be trained with: names it and the valid choice."""


class DatasetError(CableSenseError):
    """A dataset that does not fit: names the fault, its place and the remedy."""


class ModelFileError(CableSenseError):
    """A model file that does not fit: names its kind and the kind needed."""


class EstimateError(CableSenseError):
    """Inputs that the model cannot take: wrong shape, not finite, or a command that is missing."""
