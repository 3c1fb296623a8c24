"""What the 54 changes of Table II tell: a gap that repeats and that nothing listed makes."""

import numpy as np
import pytest
from table2_diagnosis import diagnosed

from cablesense_gap.verdict import UNKNOWN
from cablesense_paper.table_2_gap import INDEPENDENT, SHIPPED, read_rehearsal, table

pytestmark = pytest.mark.slow  # fits every listed effect


def test_the_table_is_read_as_hung_loads():
    changes = table("physical")
    assert changes.changes_n.shape == (6, 9)
    assert list(changes.load_segment) == [1, 2, 3, 1, 2, 3]
    np.testing.assert_allclose(changes.load_n[:, 2], [-9.81] * 3 + [-19.62] * 3)


def test_the_verdict_is_unknown_by_the_counts_that_ship():
    found = diagnosed()
    assert found.verdict.effects == (UNKNOWN,)
    assert found.rehearsal == read_rehearsal(SHIPPED)
    assert found.verdict.probability == found.rehearsal.probability > 0.5
    assert sum(c.probability for c in found.verdict.candidates) == pytest.approx(1.0)
    assert 0.0 < INDEPENDENT < 54


def test_a_law_in_proportion_leaves_less_than_any_listed_effect():
    found = diagnosed()
    gap = found.verdict.gap
    listed = [c for c in found.verdict.candidates if c.effects != (UNKNOWN,)]
    assert gap.floor_n < gap.after_n < min(c.held_out_rmse_n for c in listed)
    assert max(c.held_out_rmse_n for c in listed) == pytest.approx(gap.before_n, rel=1e-2)


def test_internal_forces_are_part_of_the_gap_and_bend_no_joint():
    found = diagnosed()
    np.testing.assert_allclose(
        found.internal_n.reshape(6, 3, 3), found.internal_n[:, ::3, None] * np.ones(3), atol=1e-9
    )
    assert (found.internal_n**2).sum() < (found.gap_n**2).sum()
