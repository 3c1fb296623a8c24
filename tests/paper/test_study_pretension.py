"""Fig. 4: 50 N at the start, a slope equal to the stiffness, and what the paper leaves out."""

import pytest
from paper_studies import disagreeing, figures, quick_result

from cablesense_paper.study import CLOSED_FORM, PAPER, Agreement

pytestmark = pytest.mark.slow  # steps MuJoCo and draws


@pytest.fixture(scope="module")
def result():
    return quick_result("pretension")


def test_the_slope_is_the_stiffness_within_its_standard_error(result):
    found = figures(result)
    assert found["slope of tension against actuator position", PAPER][2] is Agreement.YES
    assert found["slope of tension against command", CLOSED_FORM][2] is Agreement.YES
    assert "± 0.0000" in found["slope of tension against actuator position", PAPER][0]


def test_it_starts_at_fifty_newtons_and_keeps_what_the_servo_leaves(result):
    found = figures(result)
    assert found["tension at the start", PAPER][0] == pytest.approx(50.0, abs=1e-6)
    kept = found["tension kept at rest, kp = 10 k", CLOSED_FORM]
    assert kept[0] == pytest.approx(50.0 / 1.1, abs=1e-5)


def test_the_swing_of_the_start_goes_from_nothing_to_nearly_twice_the_pretension(result):
    found = figures(result)
    assert found["lowest force of the starting swing", PAPER][0] == pytest.approx(0.0, abs=1e-9)
    assert 80.0 < found["highest force of the starting swing", PAPER][0] < 100.0 / 1.1
    assert disagreeing(result) == []


def test_both_ways_to_the_pretension_come_to_the_same(result):
    for _, by_spring, by_signal, closed in result.tables[0].rows:
        assert by_spring == pytest.approx(closed, abs=1e-4)
        assert by_signal == pytest.approx(closed, abs=1e-4)
