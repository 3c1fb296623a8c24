"""Errors of training and of datasets."""

from __future__ import annotations

from cablesense_base import CableSenseError


class TrainingError(CableSenseError):
    """A network, setting or dataset that cannot be trained with: names it and the valid choice."""


class DatasetError(CableSenseError):
    """A dataset that does not fit: names the fault, its place and the remedy."""
