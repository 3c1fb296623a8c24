"""Fig. 6 and equation (2): which law of friction slips by it, which holds, and which creeps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from paper.studies.friction import (
    Friction,
    capstan_limit_n,
    friction,
    quasi_static_tensions_n,
    stepped_tensions_n,
)
from paper.study import PAPER, Agreement
from tests.helpers.paper_studies import compared, disagreeing, result_of

MU = 0.2
WRAP_RAD = np.pi


@given(st.floats(1.0, 1e3), st.floats(0.0, 6.0))
def test_the_limit_is_equation_2(near_n, friction_rad):
    far_n = near_n * np.exp(-friction_rad)
    assert capstan_limit_n(near_n, far_n, friction_rad) == pytest.approx(near_n - far_n)


@pytest.mark.parametrize("coefficient", [0.0, 0.1, 0.5])
def test_in_slip_the_effect_leaves_exp_of_minus_mu_theta(coefficient):
    near, far = quasi_static_tensions_n(np.linspace(0.0, 4e-5, 50), coefficient, WRAP_RAD)[-1]
    assert far / near == pytest.approx(np.exp(-coefficient * WRAP_RAD), rel=1e-9)


def test_both_halves_together_are_as_long_as_the_drive_says():
    path = 1e-6 * np.array([0.0, 3.0, 8.0, 5.0, -2.0, 1.0])
    tensions = quasi_static_tensions_n(path, MU, WRAP_RAD)
    np.testing.assert_allclose(tensions.sum(axis=1), 100.0 + 2e7 * path, rtol=1e-9)


def test_in_slip_mujoco_comes_to_the_same():
    way = 8e-6 * np.clip(np.arange(1300) / 1000, 0.0, 1.0)
    stepped = stepped_tensions_n(way, Friction.CAPSTAN, MU, WRAP_RAD)[-1]
    np.testing.assert_allclose(
        quasi_static_tensions_n(way[::50], MU, WRAP_RAD)[-1], stepped, rtol=1e-4
    )


@pytest.fixture(scope="module")
def result():
    sweep = {"coefficients": [0.05, 0.5], "half_turns": [0.25, 1.5]}
    return result_of("friction", friction, {"cycle_s": 2.0, "rest_s": 5.0, **sweep})


@pytest.mark.slow
def test_equation_2_is_recovered_over_the_sweep(result):
    worst, _, agreement = compared(result)["T_out / T_in in slip, largest share off", PAPER]
    assert worst < 1e-6
    assert agreement is Agreement.YES


@pytest.mark.slow
def test_what_holds_and_what_creeps(result):
    remaining = {row[0]: row[2] for row in result.tables[0].rows}
    assert remaining["capstan"] == pytest.approx(100.0, abs=0.01)
    assert remaining["yielding spring"] == pytest.approx(100.0, abs=0.01)
    assert remaining["frictionloss"] < 1.0
    assert 10.0 < remaining["frictionloss, hardened"] < 60.0
    assert disagreeing(result) == []
