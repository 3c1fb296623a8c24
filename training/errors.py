"""Errors of training.

What is raised when a dataset, a protocol or a generation run does not fit.
"""

from cablesense_base.errors import CableSenseError


class TrainingError(CableSenseError):
    """A network, setting or dataset that cannot be trained with: says which, and what is right."""


class DatasetError(CableSenseError):
    """A dataset that does not fit: says what is wrong, where, and what would be right."""
