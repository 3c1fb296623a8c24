"""The diagnosis of Table II, done once for all tests that look at it."""

from __future__ import annotations

from functools import cache
from unittest.mock import patch

from cablesense_paper import tension_changes
from cablesense_paper.table_2_gap import Findings, diagnose_table


@cache
def diagnosed() -> Findings:
    """With the counts of the rehearsal that ship, and ranges gone through more coarsely."""
    with patch.object(tension_changes, "VALUES", 21):
        return diagnose_table(None, "cablesense paper")
