"""Errors of training."""

from cablesense_msgs_py.errors import CableSenseError


class TrainingError(CableSenseError):
    """A network, setting or dataset that cannot be trained with: says which, and what is right."""
