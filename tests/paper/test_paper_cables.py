"""The three tendons of Fig. 3: 1 m each, tensioned alike, drawn as commanded, and rendered."""

import mujoco
import numpy as np
import pytest

from examples.paper import cables
from examples.paper.cables import (
    LENGTH_M,
    SCENES,
    around_a_cylinder,
    drive_direction,
    driven_at_both_ends,
    fixed_and_driven,
    rendered_scenes,
)


def measured(spec):
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def tensions_n(model, data):
    return model.tendon_stiffness * (data.ten_length - model.tendon_lengthspring[:, 1])


@pytest.mark.parametrize(
    "spec",
    [fixed_and_driven(1e8, 1e4), driven_at_both_ends(1e8, 1e4)]
    + [around_a_cylinder(wrap) for wrap in (0.3, 1.5, np.pi, 4.7, 5.6)],
    ids=["fixed", "both", "0.3 rad", "1.5 rad", "3.1 rad", "4.7 rad", "5.6 rad"],
)
def test_every_cable_is_a_metre_long_and_tensioned_to_fifty_newtons(spec):
    model, data = measured(spec)
    assert data.ten_length.sum() == pytest.approx(LENGTH_M, abs=1e-9)
    np.testing.assert_allclose(tensions_n(model, data), 50.0, atol=1e-5)


def test_a_servo_draws_the_cable_by_its_own_way():
    for spec in (fixed_and_driven(1e8, 1e4), driven_at_both_ends(1e8, 1e4)):
        model, data = measured(spec)
        for joint in range(model.njnt):
            data.qpos[:] = 0.0
            data.qpos[joint] = 7e-6
            mujoco.mj_forward(model, data)
            assert data.ten_length[0] - LENGTH_M == pytest.approx(7e-6, abs=1e-12)


def test_with_a_bias_the_cable_begins_just_slack():
    model, data = measured(fixed_and_driven(1e8, 1e4, bias_m=5e-6))
    assert tensions_n(model, data)[0] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("wrap_rad", [0.3, 1.5, np.pi, 4.7])
def test_the_ring_passes_cable_from_one_half_to_the_other(wrap_rad):
    model, data = measured(around_a_cylinder(wrap_rad))
    data.mocap_pos[0] += 4e-6 * drive_direction(wrap_rad)
    data.joint("ring").qpos = 3e-6 / 0.05
    mujoco.mj_forward(model, data)
    near, far = data.ten_length - 0.5 * LENGTH_M
    assert near == pytest.approx(4e-6 - 3e-6, abs=1e-9)
    assert far == pytest.approx(3e-6, abs=1e-9)


@pytest.mark.slow
def test_a_rendered_scene_shows_a_cable_on_white():
    pictures, backend = rendered_scenes(SCENES[:1], 160, 96)
    if not pictures:
        pytest.skip("no OpenGL without a screen here")
    assert backend in cables.BACKENDS
    assert pictures[0].shape == (96, 160, 3)
    assert (pictures[0] > 250).all(axis=-1).mean() > 0.5
    orange = (pictures[0][..., 0] > 120) & (pictures[0][..., 2] < 80)
    assert orange.sum() > 20


@pytest.mark.parametrize(("name", "value"), [("BACKENDS", ("none",)), ("_LONGEST_S", 0.01)])
def test_without_opengl_or_in_time_there_is_no_picture(name, value, monkeypatch):
    monkeypatch.setattr(cables, name, value)
    assert rendered_scenes(SCENES[:1], 64, 48) == ([], "")
