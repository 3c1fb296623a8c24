"""Rows count where at most two cables are slack."""

from __future__ import annotations

import numpy as np
import pytest

from cablesense_gap.arm_simulator import MOST_SLACK, SLACK_N, with_one_rest


@pytest.mark.parametrize("slack", range(5))
def test_two_slack_cables_are_the_most(slack):
    tensions_n = np.full((1, 12), 40.0)
    tensions_n[0, :slack] = 0.5 * SLACK_N
    assert with_one_rest(tensions_n).tolist() == [slack <= MOST_SLACK]


def test_every_row_is_judged_by_itself_whatever_is_in_front():
    tensions_n = np.full((3, 5, 12), 40.0)
    tensions_n[1, 4, :3] = 0.0
    one = with_one_rest(tensions_n)
    assert one.shape == (3, 5)
    assert np.argwhere(~one).tolist() == [[1, 4]]
