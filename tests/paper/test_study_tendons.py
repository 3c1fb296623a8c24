"""Fig. 3: the three tendons are shown, rendered or drawn."""

import pytest
from paper_studies import disagreeing, quick_result

pytestmark = pytest.mark.slow  # renders, in a process of its own


def test_the_three_tendons_are_a_metre_long_and_shown():
    result = quick_result("tendons")
    assert disagreeing(result) == []
    assert [row[1:3] for row in result.tables[0].rows] == [pytest.approx((1.0, 50.0))] * 3
    (shown,) = result.pictures
    assert "Fig. 3" in shown.caption


def test_without_opengl_they_are_drawn_and_the_caption_says_so(monkeypatch):
    monkeypatch.setattr("cablesense_paper.cables.BACKENDS", ())
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    (shown,) = quick_result("tendons").pictures
    assert "no OpenGL" in shown.caption
    assert "Rendered by MuJoCo" not in shown.caption
