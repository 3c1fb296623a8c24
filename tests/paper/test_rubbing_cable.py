"""Friction on the cylinder: equation (2) in slip, a hold at rest, and what frictionloss is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_paper.rubbing_cable import Friction, RubbingCable, capstan_limit_n


def pulled(friction, high_m=8e-6, coefficient=0.2, wrap_rad=np.pi, rest=300):
    """The cable and its tensions after a pull of a second and some steps of rest."""
    cable = RubbingCable(friction, coefficient, wrap_rad)
    course = high_m * np.clip(np.arange(1000 + rest) / 1000, 0.0, 1.0)
    return cable, cable.drawn(course)


@given(st.floats(1.0, 1e3), st.floats(0.0, 6.0))
def test_the_limit_is_equation_2(near_n, friction_rad):
    far_n = near_n * np.exp(-friction_rad)
    assert capstan_limit_n(near_n, far_n, friction_rad) == pytest.approx(near_n - far_n)


@pytest.mark.parametrize("coefficient", [0.05, 0.3, 0.6])
@pytest.mark.parametrize("wrap_rad", [0.5, np.pi, 4.5])
def test_in_slip_the_capstan_leaves_exp_of_minus_mu_theta(coefficient, wrap_rad):
    enough_m = 5.0 * 50.0 * np.expm1(coefficient * wrap_rad) / 2e7
    _, tensions = pulled(Friction.CAPSTAN, enough_m, coefficient, wrap_rad)
    near, far = tensions[-1]
    assert far / near == pytest.approx(np.exp(-coefficient * wrap_rad), rel=1e-6)


def test_let_out_again_the_ratio_is_turned_over():
    cable, _ = pulled(Friction.CAPSTAN)
    back = np.concatenate([np.linspace(8e-6, -1e-6, 1000), np.full(300, -1e-6)])
    near, far = cable.drawn(back)[-1]
    assert near / far == pytest.approx(np.exp(-0.2 * np.pi), rel=1e-6)


def test_without_friction_both_halves_carry_the_same():
    _, tensions = pulled(Friction.NONE)
    np.testing.assert_allclose(tensions[-1], 50.0 + 1e7 * 8e-6, rtol=1e-6)


@pytest.mark.parametrize("friction", [Friction.YIELDING, Friction.CAPSTAN])
def test_what_yields_holds_for_ever(friction):
    cable, tensions = pulled(friction)
    held = cable.drawn(np.full(5000, 8e-6))[-1]
    np.testing.assert_allclose(held, tensions[-1], rtol=1e-6)


def test_frictionloss_lets_go_at_once_as_it_comes_and_in_seconds_when_hardened():
    _, soft = pulled(Friction.FRICTIONLOSS)
    assert abs(soft[-1, 0] - soft[-1, 1]) < 0.01
    cable, hard = pulled(Friction.HARDENED, rest=0)
    limit_n = float(capstan_limit_n(50.0, 50.0, 0.2 * np.pi))
    assert hard[-1, 0] - hard[-1, 1] == pytest.approx(limit_n, rel=1e-3)
    near, far = cable.drawn(np.full(10_000, 8e-6))[-1]
    assert near - far < 0.2 * limit_n


def test_a_fixed_force_is_the_same_at_every_tension():
    differences = []
    for high_m in (8e-6, 16e-6):
        _, tensions = pulled(Friction.YIELDING, high_m)
        differences.append(tensions[-1, 0] - tensions[-1, 1])
    assert differences[0] == pytest.approx(differences[1], rel=1e-6)
