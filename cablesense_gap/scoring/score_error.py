"""The error of what cannot be scored."""

from __future__ import annotations

from cablesense_msgs_py.errors import CableSenseError


class ScoreError(CableSenseError):
    """Verdicts or answers that cannot be scored: says which, and what is right."""
