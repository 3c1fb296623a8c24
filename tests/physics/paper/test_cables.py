"""The metre of cable of Fig. 3 to 5: models, closed forms against an ODE and MuJoCo, studies."""

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from paper.cables import (
    LENGTH_M,
    PRETENSION_N,
    STIFFNESS_N_M,
    around_a_cylinder,
    drive_direction,
    driven_at_both_ends,
    fixed_and_driven,
)
from paper.servo_cable import positions_at_rest_m, tension_at_rest_n
from paper.studies import servo
from paper.study import CLOSED_FORM, PAPER, Agreement
from tests.helpers.paper_studies import compared, disagreeing, quick_result, result_of

GAINS = (1e6, 1e7, 1e8, 1e9)
stiffnesses = st.floats(1e3, 1e9)


@given(stiffnesses, stiffnesses, st.integers(1, 4), st.floats(-1e3, 1e3))
def test_rest_is_where_every_servo_balances_the_cable(k, kp, servos, unyielding_n):
    tension = tension_at_rest_n(unyielding_n, k, kp, servos)
    assert unyielding_n - k * servos * tension / kp == pytest.approx(tension, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("kp_n_m", GAINS)
def test_both_servos_rest_by_the_closed_form_short_of_their_commands(kp_n_m):
    commands = np.array([[0.0, 0.0], [0.0, 2e-5], [1e-5, -5e-6]])
    short = commands - positions_at_rest_m(kp_n_m, commands)
    unyielding = PRETENSION_N + STIFFNESS_N_M * commands.sum(axis=1)
    expected = tension_at_rest_n(unyielding, STIFFNESS_N_M, kp_n_m, 2) / kp_n_m
    np.testing.assert_allclose(short, np.stack([expected, expected], axis=1), rtol=1e-6)


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
def test_the_three_tendons_are_a_metre_long_and_shown():
    result = quick_result("tendons")
    assert disagreeing(result) == []
    assert [row[1:3] for row in result.tables[0].rows] == [pytest.approx((1.0, 50.0))] * 3


@pytest.fixture(scope="module")
def pretension():
    return quick_result("pretension")


@pytest.mark.slow
def test_the_slope_is_the_stiffness_within_its_standard_error(pretension):
    figures = compared(pretension)
    assert figures["slope of tension against actuator position", PAPER][2] is Agreement.YES
    assert figures["slope of tension against command", CLOSED_FORM][2] is Agreement.YES
    assert "± 0.0000" in figures["slope of tension against actuator position", PAPER][0]


@pytest.mark.slow
def test_the_swing_of_the_start_goes_from_nothing_to_nearly_twice_the_pretension(pretension):
    figures = compared(pretension)
    lowest = figures["lowest force of the starting swing", PAPER][0]
    assert lowest == pytest.approx(0.0, abs=1e-9)
    assert 80.0 < figures["highest force of the starting swing", PAPER][0] < 100.0 / 1.1
    assert disagreeing(pretension) == []


@pytest.fixture(scope="module")
def self_locking():
    return result_of("self_locking", servo.self_locking, {"commands": 3, "gains": 4, "side": 7})


@pytest.mark.slow
def test_errors_and_map_are_those_of_the_closed_forms(self_locking):
    figures = compared(self_locking)
    assert disagreeing(self_locking) == []
    assert figures["cells of the map on the wrong side of the closed form", CLOSED_FORM][0] == 0


@pytest.mark.slow
def test_every_statement_of_the_paper_holds(self_locking):
    of_paper = [found for (_, source), found in compared(self_locking).items() if source == PAPER]
    assert len(of_paper) == 4
    assert all(agreement is Agreement.YES for *_, agreement in of_paper)
