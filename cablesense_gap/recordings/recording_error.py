"""The error of a recording that cannot be used."""

from __future__ import annotations

from cablesense_msgs_py.errors import CableSenseError


class RecordingError(CableSenseError):
    """A recording that cannot be used: says which file, what, in which rows, and what is right."""
