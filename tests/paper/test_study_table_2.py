"""Table II: the part in proportion to the load is the paper's, by statics and by MuJoCo."""

import pytest
from paper_studies import disagreeing, figures, quick_result

from cablesense_paper.study import PAPER, Agreement

pytestmark = pytest.mark.slow  # steps MuJoCo and draws


@pytest.fixture(scope="module")
def result():
    return quick_result("table_2")


def test_what_the_second_kilogram_adds_is_the_papers(result):
    found = figures(result)
    assert found["2 kg row less 1 kg row, largest difference of a cell", PAPER][0] <= 0.45
    assert found["2 kg row less 1 kg row, difference RMS", PAPER][0] <= 0.2


def test_the_papers_largest_error_is_in_its_table_and_ours_is_smaller(result):
    found = figures(result)
    own = found["largest error of the paper’s simulation, from its table", PAPER]
    assert own[0] == pytest.approx(5.97)
    assert own[2] is Agreement.YES
    assert found["largest error against the physical rows", PAPER][0] < 5.98


def test_statics_and_stepping_come_to_the_same_rest(result):
    assert disagreeing(result) == []


def test_all_eighteen_rows_are_shown(result):
    assert len(result.tables[0].rows) == 18
    assert {row[1] for row in result.tables[0].rows} == {"physical", "the paper’s", "ours"}
