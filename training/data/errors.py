"""What is raised when a dataset, a protocol or a generation run does not fit."""

from cablesense_msgs_py.errors import CableSenseError


class DatasetError(CableSenseError):
    """A dataset that does not fit: says what is wrong, where, and what would be right."""
