"""Fig. 6 and equation (2): which friction slips by it, which holds, and which creeps."""

import pytest
from paper_studies import disagreeing, figures, quick_result

from cablesense_paper.study import PAPER, Agreement

pytestmark = pytest.mark.slow  # steps MuJoCo through loops and rests


@pytest.fixture(scope="module")
def result():
    return quick_result("friction")


def test_equation_2_is_recovered_over_the_sweep(result):
    worst, _, agreement = figures(result)["T_out / T_in in slip, largest share off", PAPER]
    assert worst < 1e-6
    assert agreement is Agreement.YES


def test_what_holds_and_what_creeps(result):
    left = {row[0]: row[2] for row in result.tables[0].rows}
    assert left["capstan"] == pytest.approx(100.0, abs=0.01)
    assert left["yielding spring"] == pytest.approx(100.0, abs=0.01)
    assert left["frictionloss"] < 1.0
    assert 10.0 < left["frictionloss, hardened"] < 60.0
    assert disagreeing(result) == []


def test_what_frictionloss_cannot_do_is_said(result):
    found = figures(result)
    assert found["frictionloss and equation (2)", PAPER][2] is Agreement.NO
    assert found["hysteresis from frictionloss", PAPER][2] is Agreement.PARTLY
