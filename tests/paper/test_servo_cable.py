"""A cable between servos: closed forms against linear algebra, an ODE solver and MuJoCo."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from examples.paper.cables import PRETENSION_N, STIFFNESS_N_M
from examples.paper.servo_cable import (
    longest_bounded_step_s,
    longest_step_s,
    positions_at_rest_m,
    starting_force_n,
    stays_bounded,
    tension_at_rest_n,
)

GAINS = (1e6, 1e7, 1e8, 1e9)
stiffnesses = st.floats(1e3, 1e9)


@given(stiffnesses, stiffnesses, st.integers(1, 4), st.floats(-1e3, 1e3))
def test_rest_is_where_every_servo_balances_the_cable(k, kp, servos, unyielding_n):
    tension = tension_at_rest_n(unyielding_n, k, kp, servos)
    assert unyielding_n - k * servos * tension / kp == pytest.approx(tension, rel=1e-6, abs=1e-6)


def test_the_start_is_that_of_an_ode_solver():
    kp, kv, mass, k, pretension = 1e8, 4e2, 0.5, 1e7, 50.0
    time_s = np.linspace(0.0, 2e-3, 400)

    def rate(_, state):
        force = -kp * state[0] - kv * state[1] - pretension - k * state[0]
        return state[1], force / mass

    solved = solve_ivp(rate, (0.0, time_s[-1]), (0.0, 0.0), t_eval=time_s, rtol=1e-9, atol=1e-18)
    expected = -kp * solved.y[0] - kv * solved.y[1]
    found = starting_force_n(time_s, pretension, k, (kp, kv, mass))
    np.testing.assert_allclose(found, expected, atol=1e-3)
    assert found[0] == 0.0


def spectral_radius(integrator, omega_step, zeta):
    """Of one step of x'' = -x - 2 ζ x' (ω = 1), from (x, v) to (x, v)."""
    h = omega_step
    implicit_speed = integrator != "Euler"
    implicit_position = integrator == "discrete"
    speed_scale = 1.0 + (2.0 * zeta * h if implicit_speed else 0.0)
    speed_scale += h * h if implicit_position else 0.0
    speed_by_speed = (1.0 - (0.0 if implicit_speed else 2.0 * zeta * h)) / speed_scale
    speed = np.array([-h / speed_scale, speed_by_speed])
    step = np.array([np.array([1.0, 0.0]) + h * speed, speed])
    return float(np.abs(np.linalg.eigvals(step)).max())


@given(st.sampled_from(["Euler", "implicit", "implicitfast"]), st.floats(0.01, 3.0))
def test_the_longest_step_is_where_a_root_of_the_step_leaves_the_unit_circle(integrator, zeta):
    limit = float(longest_step_s(1.0, zeta, integrator))
    assert spectral_radius(integrator, 0.999 * limit, zeta) < 1.0
    assert spectral_radius(integrator, 1.001 * limit, zeta) > 1.0


@pytest.mark.parametrize("kp_n_m", GAINS)
def test_both_servos_rest_by_the_closed_form_short_of_their_commands(kp_n_m):
    commands = np.array([[0.0, 0.0], [0.0, 2e-5], [1e-5, -5e-6]])
    short = commands - positions_at_rest_m(kp_n_m, commands)
    unyielding = PRETENSION_N + STIFFNESS_N_M * commands.sum(axis=1)
    expected = tension_at_rest_n(unyielding, STIFFNESS_N_M, kp_n_m, 2) / kp_n_m
    np.testing.assert_allclose(short, np.stack([expected, expected], axis=1), rtol=1e-6)


@pytest.mark.parametrize("kp_n_m", GAINS)
@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast"])
def test_steps_up_to_the_limit_are_stable_and_longer_ones_are_not(integrator, kp_n_m):
    limit_s = float(longest_bounded_step_s(kp_n_m, integrator))
    assert stays_bounded(kp_n_m, 0.97 * limit_s, integrator)
    assert not stays_bounded(kp_n_m, 1.03 * limit_s, integrator)


@pytest.mark.parametrize("kp_n_m", GAINS)
def test_discrete_bears_any_step(kp_n_m):
    assert longest_bounded_step_s(kp_n_m, "discrete") == np.inf
    assert all(stays_bounded(kp_n_m, step, "discrete") for step in (1e-6, 1e-3, 1.0))
