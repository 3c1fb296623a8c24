"""Fig. 9: the arm follows its course, and its tensions do what its weight lets them."""

import pytest
from paper_studies import disagreeing, figures, quick_result

from cablesense_paper.study import PAPER, Agreement

pytestmark = pytest.mark.slow  # steps the arm through a course, twice


@pytest.fixture(scope="module")
def result():
    return quick_result("joint_course")


def test_the_arm_without_weight_does_as_the_paper_says(result):
    found = figures(result)
    for what in ("joint angles", "tensions, arm without weight", "actuator tracking error"):
        assert found[what, PAPER][2] is Agreement.YES, what


def test_the_arm_with_its_weight_does_not(result):
    assert figures(result)["tensions, arm with its weight", PAPER][2] is Agreement.NO


def test_time_and_statics_agree_and_actuators_follow_their_law(result):
    assert disagreeing(result) == []
    rows = {row[0]: row[2:] for row in result.tables[0].rows}
    assert rows["joint tracking error, largest"][0] < 0.01
    assert rows["lowest tension"][0] > 45.0
    assert rows["highest tension"][0] < 55.0
