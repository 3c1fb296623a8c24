"""This project's friction on the cylinder: equation (2), memory, and MuJoCo's loop beside it."""

import numpy as np
import pytest

from cablesense_paper.rubbing_cable import Friction, RubbingCable, rubbing_tensions_n

MU, WRAP_RAD = 0.2, np.pi


@pytest.mark.parametrize("coefficient", [0.0, 0.1, 0.5])
def test_in_slip_it_leaves_exp_of_minus_mu_theta(coefficient):
    near, far = rubbing_tensions_n(np.linspace(0.0, 4e-5, 50), coefficient, WRAP_RAD)[-1]
    assert far / near == pytest.approx(np.exp(-coefficient * WRAP_RAD), rel=1e-9)


def test_both_halves_together_are_as_long_as_the_drive_says():
    course = 1e-6 * np.array([0.0, 3.0, 8.0, 5.0, -2.0, 1.0])
    tensions = rubbing_tensions_n(course, MU, WRAP_RAD)
    np.testing.assert_allclose(tensions.sum(axis=1), 100.0 + 2e7 * course, rtol=1e-9)


def test_the_same_place_has_two_tensions_by_way_of_the_past():
    up_and_down = 1e-6 * np.array([0.0, 4.0, 8.0, 4.0, -1.0, 4.0])
    near = rubbing_tensions_n(up_and_down, MU, WRAP_RAD)[:, 0]
    assert near[1] - near[3] > 10.0
    assert near[5] > near[3]


def test_in_slip_mujoco_comes_to_the_same():
    way = 8e-6 * np.clip(np.arange(1300) / 1000, 0.0, 1.0)
    stepped = RubbingCable(Friction.CAPSTAN, MU, WRAP_RAD).drawn(way)[-1]
    np.testing.assert_allclose(rubbing_tensions_n(way[::50], MU, WRAP_RAD)[-1], stepped, rtol=1e-4)
