"""Pictures without a screen, and none where there is no OpenGL."""

import pytest

from cablesense_paper import cables
from cablesense_paper.cables import SCENES


def test_a_scene_shows_a_cable_on_white():
    pictures, backend = cables.rendered_scenes(SCENES[:1], 160, 96)
    if not pictures:
        pytest.skip("no OpenGL without a screen here")
    assert backend in cables.BACKENDS
    assert pictures[0].shape == (96, 160, 3)
    assert (pictures[0] > 250).all(axis=-1).mean() > 0.5
    orange = (pictures[0][..., 0] > 120) & (pictures[0][..., 2] < 80)
    assert orange.sum() > 20


def test_without_opengl_there_is_no_picture(monkeypatch):
    monkeypatch.setattr(cables, "BACKENDS", ("none",))
    assert cables.rendered_scenes(SCENES[:1], 64, 48) == ([], "")


def test_a_renderer_that_hangs_is_given_up(monkeypatch):
    monkeypatch.setattr(cables, "_LONGEST_S", 0.01)
    assert cables.rendered_scenes(SCENES[:1], 64, 48) == ([], "")
