"""Section II-A: MuJoCo measures the lengths that are commanded."""

import pytest
from paper_studies import disagreeing, quick_result

pytestmark = pytest.mark.slow  # steps MuJoCo and draws


def test_commanded_lengths_are_mujocos_and_lead_back_to_the_angles():
    result = quick_result("displacement")
    assert len(result.comparisons) == 2
    assert disagreeing(result) == []
    (table,) = result.tables
    assert sum(row[2].count("[") for row in table.rows) == 13  # references of Table I
