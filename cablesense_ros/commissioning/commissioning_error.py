"""The error of a commissioning that cannot be done with what was given."""

from __future__ import annotations

from cablesense_msgs_py.errors import CableSenseError


class CommissioningError(CableSenseError):
    """What was given cannot be used: names file, row or cable, and what would be right."""
