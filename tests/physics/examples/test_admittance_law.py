"""The admittance's law is that of a damped mass, gives no energy, and keeps to its speed."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rclpy")

from cablesense_sim import kinematics, mechanism_of, normal_force_n, open_arm
from examples.admittance import (
    DAMPING_N_M_S,
    FASTEST_RAD_S,
    INERTIA_KG_M2,
    PERIOD_S,
    next_speeds_rad_s,
)

MECHANISM = mechanism_of(open_arm("cdsm"))
STILL_RAD_S = np.zeros(8)
TIME_CONSTANT_S = INERTIA_KG_M2 / DAMPING_N_M_S
WITHIN_SPEED_N_M = 0.999 * FASTEST_RAD_S * DAMPING_N_M_S

slow_torques = st.lists(
    st.floats(-WITHIN_SPEED_N_M, WITHIN_SPEED_N_M), min_size=8, max_size=8
).map(np.array)
torques = st.lists(st.floats(-100.0, 100.0), min_size=8, max_size=8).map(np.array)


def after_periods(speeds_rad_s, torques_n_m, count, period_s=PERIOD_S):
    for _ in range(count):
        speeds_rad_s = next_speeds_rad_s(speeds_rad_s, torques_n_m, period_s)
    return speeds_rad_s


@given(slow_torques, st.integers(1, 100), st.floats(0.001, 0.1))
def test_a_constant_force_gives_the_step_response_however_often_it_is_sampled(
    torques_n_m, count, period_s
):
    risen = 1.0 - math.exp(-count * period_s / TIME_CONSTANT_S)
    speeds_rad_s = after_periods(STILL_RAD_S, torques_n_m, count, period_s)
    assert speeds_rad_s == pytest.approx(risen * torques_n_m / DAMPING_N_M_S, abs=1e-12)


def test_a_push_turns_the_joints_up_to_its_segment_by_its_levers_over_the_damping():
    """A straight arm that is pushed sideways: torque is force times distance, about yaw alone."""
    straight_rad = np.zeros(8)
    force_n = normal_force_n(MECHANISM, straight_rad, 3, 90.0, 10.0)[2]
    jacobian_m = kinematics.contact_jacobians_m(MECHANISM, straight_rad)[2]
    place_m = kinematics.contact_points_m(MECHANISM, straight_rad)[2]
    levers_m = place_m[0] - kinematics.joint_positions_m(MECHANISM, straight_rad)[:, 0]
    speeds_rad_s = after_periods(STILL_RAD_S, jacobian_m.T @ force_n, 500)
    assert speeds_rad_s[1::2][:3] == pytest.approx(10.0 * levers_m[:3] / DAMPING_N_M_S)
    assert speeds_rad_s[[0, 2, 4, 6, 7]] == pytest.approx(0.0, abs=1e-12)


@given(torques, torques)
def test_no_joint_is_faster_than_the_limit_and_a_slowed_arm_keeps_its_direction(first, second):
    speeds_rad_s = next_speeds_rad_s(STILL_RAD_S, first, 10.0)
    assert np.abs(speeds_rad_s).max() <= FASTEST_RAD_S * (1.0 + 1e-12)
    assert speeds_rad_s * np.abs(first).max() == pytest.approx(first * np.abs(speeds_rad_s).max())
    speeds_rad_s = next_speeds_rad_s(speeds_rad_s, second, PERIOD_S)
    assert np.abs(speeds_rad_s).max() <= FASTEST_RAD_S * (1.0 + 1e-12)


@given(torques, torques)
def test_it_takes_at_least_the_kinetic_energy_from_the_contact(before, torques_n_m):
    """Passivity: M v²/2 grows by no more than the work of the contact in the period."""
    speeds_rad_s = next_speeds_rad_s(STILL_RAD_S, before, 10.0)
    next_rad_s = next_speeds_rad_s(speeds_rad_s, torques_n_m, PERIOD_S)
    # the unlimited law turns the joints by the integral of v(t), exactly
    steady_rad_s = torques_n_m / DAMPING_N_M_S
    faded_s = TIME_CONSTANT_S * (1.0 - math.exp(-PERIOD_S / TIME_CONSTANT_S))
    turned_rad = PERIOD_S * steady_rad_s + faded_s * (speeds_rad_s - steady_rad_s)
    gained_j = 0.5 * INERTIA_KG_M2 * (next_rad_s @ next_rad_s - speeds_rad_s @ speeds_rad_s)
    assert torques_n_m @ turned_rad >= gained_j - 1e-9


@pytest.mark.parametrize("dead_periods", [0, 4, 15])
@pytest.mark.parametrize("segment", [1, 2, 3, 4])
def test_an_arm_that_is_held_elastically_comes_to_rest_below_the_stated_stiffness(
    segment, dead_periods
):
    """As stated: k |j|² (T + M / D) < π D / 2, with T the dead time and the period."""
    straight_rad = np.zeros(8)
    lever_m = kinematics.contact_jacobians_m(MECHANISM, straight_rad)[segment - 1][1]
    delay_s = (dead_periods + 1) * PERIOD_S + TIME_CONSTANT_S
    bound_n_m = 0.5 * math.pi * DAMPING_N_M_S / (lever_m @ lever_m * delay_s)
    stiffness_n_m = 0.9 * bound_n_m
    start_n = 5.0
    forces_n = [start_n] * (dead_periods + 1)
    speeds_rad_s = STILL_RAD_S
    angles_rad = straight_rad
    for _ in range(2000):
        speeds_rad_s = next_speeds_rad_s(
            speeds_rad_s, lever_m * forces_n[-1 - dead_periods], PERIOD_S
        )
        angles_rad = angles_rad + PERIOD_S * speeds_rad_s
        forces_n.append(start_n - stiffness_n_m * (lever_m @ angles_rad))
    assert np.abs(forces_n[-50:]).max() < 0.01 * start_n
