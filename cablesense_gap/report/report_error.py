"""The error of a report that cannot be written."""

from __future__ import annotations

from cablesense_msgs_py.errors import CableSenseError


class ReportError(CableSenseError):
    """A report that cannot be written: says where, and why."""
