"""MuJoCo's cable between two servos rests and bursts where the closed forms say."""

import mujoco
import numpy as np
import pytest

from cablesense_paper.cables import PRETENSION_N, STIFFNESS_N_M
from cablesense_paper.servo_cable import (
    INTEGRATORS,
    longest_bounded_step_s,
    positions_at_rest_m,
    stays_bounded,
    steady_error_m,
)

GAINS = (1e6, 1e7, 1e8, 1e9)


@pytest.mark.parametrize("kp_n_m", GAINS)
def test_both_servos_rest_by_the_closed_form_short_of_their_commands(kp_n_m):
    commands = np.array([[0.0, 0.0], [0.0, 2e-5], [1e-5, -5e-6]])
    short = commands - positions_at_rest_m(kp_n_m, commands)
    unyielding = PRETENSION_N + STIFFNESS_N_M * commands.sum(axis=1)
    expected = steady_error_m(unyielding, STIFFNESS_N_M, kp_n_m, 2)
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


def test_the_names_are_mujocos():
    for name, integrator in INTEGRATORS.items():
        model = mujoco.MjModel.from_xml_string(f'<mujoco><option integrator="{name}"/></mujoco>')
        assert model.opt.integrator == integrator


def test_an_unstable_run_says_nothing_on_the_terminal(capfd):
    assert not stays_bounded(1e9, 1e-2, "Euler")
    assert capfd.readouterr() == ("", "")
