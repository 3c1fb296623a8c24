"""The diagnosis of Table II, done once for all tests that look at it."""

from __future__ import annotations

from functools import cache
from unittest.mock import patch

from cablesense_gap import one_number
from cablesense_gap.table2.findings import Findings, diagnose_table


@cache
def diagnosed() -> Findings:
    """With the counts of the rehearsal that ship, and ranges gone through more coarsely."""
    with patch.object(one_number, "VALUES", 21):
        return diagnose_table(None, "cablesense paper")
