"""The studies on a single cable: Fig. 3 to 5 against closed forms."""

import pytest
from paper_studies import compared, disagreeing, quick_result, result_of

from examples.paper.studies import servo
from examples.paper.study import CLOSED_FORM, PAPER, Agreement

pytestmark = pytest.mark.slow  # step MuJoCo, render in a process of their own, and draw


def test_the_three_tendons_are_a_metre_long_and_shown():
    result = quick_result("tendons")
    assert disagreeing(result) == []
    assert [row[1:3] for row in result.tables[0].rows] == [pytest.approx((1.0, 50.0))] * 3
    (shown,) = result.pictures
    assert "Fig. 3" in shown.caption


def test_without_opengl_they_are_drawn_and_the_caption_states_it(monkeypatch):
    monkeypatch.setattr("examples.paper.cables.BACKENDS", ())
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    (shown,) = quick_result("tendons").pictures
    assert "no OpenGL" in shown.caption
    assert "Rendered by MuJoCo" not in shown.caption


@pytest.fixture(scope="module")
def pretension():
    return quick_result("pretension")


def test_the_slope_is_the_stiffness_within_its_standard_error(pretension):
    found = compared(pretension)
    assert found["slope of tension against actuator position", PAPER][2] is Agreement.YES
    assert found["slope of tension against command", CLOSED_FORM][2] is Agreement.YES
    assert "± 0.0000" in found["slope of tension against actuator position", PAPER][0]


def test_it_starts_at_fifty_newtons_and_keeps_what_the_servo_leaves(pretension):
    found = compared(pretension)
    assert found["tension at the start", PAPER][0] == pytest.approx(50.0, abs=1e-6)
    kept = found["tension kept at rest, kp = 10 k", CLOSED_FORM]
    assert kept[0] == pytest.approx(50.0 / 1.1, abs=1e-5)


def test_the_swing_of_the_start_goes_from_nothing_to_nearly_twice_the_pretension(pretension):
    found = compared(pretension)
    lowest = found["lowest force of the starting swing", PAPER][0]
    assert lowest == pytest.approx(0.0, abs=1e-9)
    assert 80.0 < found["highest force of the starting swing", PAPER][0] < 100.0 / 1.1
    assert disagreeing(pretension) == []


def test_both_ways_to_the_pretension_come_to_the_same(pretension):
    for _, by_spring, by_signal, closed in pretension.tables[0].rows:
        assert by_spring == pytest.approx(closed, abs=1e-4)
        assert by_signal == pytest.approx(closed, abs=1e-4)


@pytest.fixture(scope="module")
def self_locking():
    return result_of("self_locking", servo.self_locking, {"commands": 3, "gains": 4, "side": 7})


def test_errors_and_map_are_those_of_the_closed_forms(self_locking):
    found = compared(self_locking)
    assert disagreeing(self_locking) == []
    assert found["cells of the map on the wrong side of the closed form", CLOSED_FORM][0] == 0


def test_every_statement_of_the_paper_holds(self_locking):
    of_paper = [found for (_, source), found in compared(self_locking).items() if source == PAPER]
    assert len(of_paper) == 4
    assert all(agreement is Agreement.YES for *_, agreement in of_paper)
