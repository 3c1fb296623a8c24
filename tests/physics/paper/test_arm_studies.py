"""The studies on an arm: Table I, Fig. 9 and Table II against closed forms and statics."""

import numpy as np
import pytest

from paper.studies.arm import PERIOD_S, trajectory_rad
from paper.study import PAPER, Agreement
from tests.helpers.paper_studies import compared, disagreeing, quick_result

QUARTER_S = 0.25 * PERIOD_S


def test_the_trajectory_goes_through_the_papers_four_angles():
    angles = trajectory_rad(PERIOD_S + QUARTER_S * np.arange(1.0, 5.0), 2)
    np.testing.assert_allclose(np.rad2deg(angles[:, 0]), [-10.0, 0.0, 10.0, 0.0], atol=1e-9)


@pytest.mark.slow
def test_commanded_lengths_are_mujocos_and_lead_back_to_the_angles():
    result = quick_result("displacement")
    assert len(result.comparisons) == 2
    assert disagreeing(result) == []
    (table,) = result.tables
    assert sum(row[2].count("[") for row in table.rows) == 13  # references of Table I


@pytest.mark.slow
def test_the_arm_follows_its_trajectory_and_its_tensions_carry_its_weight():
    result = quick_result("joint_course")
    assert disagreeing(result) == []  # with statics, and with the servo's law
    agreements = {what: found[2] for (what, _), found in compared(result).items()}
    for what in ("joint angles", "tensions, arm without weight", "actuator tracking error"):
        assert agreements[what] is Agreement.YES, what
    assert agreements["tensions, arm with its weight"] is Agreement.NO
    rows = {row[0]: row[2:] for row in result.tables[0].rows}
    assert rows["joint tracking error, largest"][0] < 0.01
    assert rows["lowest tension"][0] > 45.0
    assert rows["highest tension"][0] < 55.0


@pytest.mark.slow
def test_the_part_of_table_2_in_proportion_to_the_load_is_the_papers():
    result = quick_result("table_2")
    assert disagreeing(result) == []  # statics against MuJoCo stepped to rest
    comparisons = compared(result)
    assert comparisons["2 kg row less 1 kg row, largest difference of a cell", PAPER][0] <= 0.45
    assert comparisons["2 kg row less 1 kg row, difference RMS", PAPER][0] <= 0.2
    paper_error = comparisons["largest error of the paper’s simulation, from its table", PAPER]
    assert paper_error[0] == pytest.approx(5.97)
    assert paper_error[2] is Agreement.YES
    assert comparisons["largest error against the physical rows", PAPER][0] < 5.98
    assert [row[1] for row in result.tables[0].rows] == ["physical", "the paper’s", "ours"] * 6
