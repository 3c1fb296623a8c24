"""Fig. 5: the joint falls short by the closed form, and the map has no cell on a wrong side."""

import pytest
from paper_studies import disagreeing, figures, quick_result

from cablesense_paper.study import CLOSED_FORM, PAPER, Agreement

pytestmark = pytest.mark.slow  # a map of simulations


@pytest.fixture(scope="module")
def result():
    return quick_result("self_locking")


def test_errors_and_map_are_those_of_the_closed_forms(result):
    found = figures(result)
    assert disagreeing(result) == []
    assert found["cells of the map on the wrong side of the closed form", CLOSED_FORM][0] == 0


def test_every_statement_of_the_paper_holds(result):
    of_paper = [found for (_, source), found in figures(result).items() if source == PAPER]
    assert len(of_paper) == 4
    assert all(agreement is Agreement.YES for *_, agreement in of_paper)


def test_more_gain_brings_the_joint_nearer(result):
    reached = [row[1] for row in result.tables[0].rows]
    assert reached == sorted(reached)
    assert reached[-1] == pytest.approx(20.0, rel=0.02)
