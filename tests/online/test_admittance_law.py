"""The law: away from the force, within its limits, passive; its loop gain is that of the docs.

Joint angles within reach: nearest, convex, short of the guide plates.

One measurement: spans its time, has no gaps, and doubt weakens it.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_online.admittance.law import (
    AdmittanceLaw,
    AdmittanceSettings,
    ContactForce,
    ForceAverage,
    Reach,
)
from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import normal_force_n

ARM = mechanism_of(open_arm("cdsm"))
REACH = Reach(ARM, np.deg2rad(10.0))
DEFAULT = AdmittanceSettings()
LAW = AdmittanceLaw(ARM, REACH, DEFAULT)
UNLIMITED = AdmittanceSettings(
    step_limit_rad=10.0, speed_limit_rad_s=100.0, smallest_step_rad=0.0, touch_n=1e9
)

poses = st.lists(st.floats(-5.0, 5.0), min_size=8, max_size=8).map(np.deg2rad)
segments = st.integers(1, 4)
angles = st.floats(0.0, 360.0)


def contact_force(command, segment, angle_deg, magnitude_n):
    force = normal_force_n(ARM, command, segment, angle_deg, magnitude_n)[segment - 1]
    return ContactForce(segment, force)


def contact_jacobian(command, segment):
    return kinematics.contact_jacobians_m(ARM, command)[segment - 1]


@given(poses, segments, angles, st.floats(2.5, 500.0), st.floats(0.05, 5.0))
def test_the_contact_point_moves_with_the_force(command, segment, angle, magnitude, elapsed):
    contact = contact_force(command, segment, angle, magnitude)
    step = LAW.step(command, command, contact, elapsed) - command
    assert contact.force_base_n @ contact_jacobian(command, segment) @ step >= 0.0
    assert np.all(step[2 * segment :] == 0.0)  # joints beyond the contact cannot help


@pytest.mark.slow
@given(poses, poses, segments, angles, st.floats(0.0, 500.0), st.floats(0.05, 5.0))
def test_limits_hold_whatever_the_contact(command, home, segment, angle, magnitude, elapsed):
    for contact in (None, contact_force(command, segment, angle, magnitude)):
        target = LAW.step(command, home, contact, elapsed)
        limit = min(DEFAULT.step_limit_rad, DEFAULT.speed_limit_rad_s * elapsed)
        assert np.abs(target - command).max() <= limit + 1e-12
        assert REACH.holds(target)


@pytest.mark.slow
@given(poses, poses, segments, angles, st.floats(0.0, 100.0), st.floats(0.05, 1.0))
def test_it_takes_no_more_energy_from_the_contact_than_it_stores(
    command, home, segment, angle, magnitude, elapsed
):
    """Passivity: work of the contact on the arm is at least what the return spring gains."""
    law = AdmittanceLaw(ARM, REACH, UNLIMITED)
    contact = contact_force(command, segment, angle, magnitude)
    stiffness = UNLIMITED.return_stiffness_n_m_rad
    step = law.step(command, home, contact, elapsed) - command
    if not REACH.holds(command + 1.001 * step):
        return  # the edge of the reach holds against the spring, which is the next test
    work = contact.force_base_n @ contact_jacobian(command, segment) @ step
    away = command - home
    gained = 0.5 * stiffness * ((away + step) @ (away + step) - away @ away)
    assert work >= gained - 1e-9


@given(poses, segments, angles, st.floats(3.0, 500.0))
def test_the_edge_of_the_reach_never_turns_a_step_round(command, segment, angle, magnitude):
    command = REACH.nearest(4.0 * command)
    contact = contact_force(command, segment, angle, magnitude)
    step = LAW.step(command, command, contact, 1.0) - command
    assert contact.force_base_n @ contact_jacobian(command, segment) @ step >= -1e-12


@pytest.mark.parametrize("magnitude", [0.0, 1.0, 1.999])
def test_a_force_within_the_deadband_moves_nothing_at_home(magnitude):
    home = np.full(8, 0.02)
    assert LAW.step(home, home, contact_force(home, 3, 40.0, magnitude), 1.0) is home


def test_a_step_solves_the_law_with_the_worst_contact_taken_off():
    """The linear system of the module's docstring, solved by a library."""
    command, home, elapsed = np.deg2rad(np.linspace(-3, 4, 8)), np.full(8, 0.01), 0.7
    contact = contact_force(command, 3, 77.0, 30.0)
    law = AdmittanceLaw(ARM, REACH, UNLIMITED)
    j = contact_jacobian(command, 3).T @ (contact.force_base_n / 30.0)
    tau = 30.0 * j - (command - home)
    tau *= 1.0 - 2.0 * np.linalg.norm(j) / np.linalg.norm(tau)
    matrix = (5.0 / elapsed + 1.0) * np.eye(8) + 20_000.0 * np.outer(j, j)
    expected = command + np.linalg.solve(matrix, tau)
    assert np.allclose(law.step(command, home, contact, elapsed), expected, atol=1e-12)


@given(poses, segments, angles, st.floats(100.0, 60_000.0))
def test_the_loop_gain_is_the_share_of_the_force_that_a_step_takes_away(
    command, segment, angle, stiffness
):
    law = AdmittanceLaw(ARM, REACH, UNLIMITED)
    contact = contact_force(command, segment, angle, 2.01)
    step = law.step(command, command, contact, 0.7) - command
    direction = contact.force_base_n / 2.01
    lost = stiffness * direction @ contact_jacobian(command, segment) @ step
    gain = law.loop_gain(command, segment, direction, stiffness, 0.7)
    assert lost == pytest.approx(gain * 0.01, rel=1e-6)
    assert gain < stiffness / DEFAULT.worst_stiffness_n_m


@given(poses, poses)
def test_the_way_home_never_meets_a_wall_with_more_than_the_touch(command, home):
    step = LAW.step(command, home, None, 1.0) - command
    moved = np.linalg.norm(kinematics.contact_jacobians_m(ARM, command) @ step, axis=-1).max()
    assert moved * DEFAULT.worst_stiffness_n_m <= DEFAULT.touch_n * (1.0 + 1e-9)
    assert (command - home) @ step <= 0.0


@pytest.mark.slow
@settings(max_examples=8)
@given(poses)
def test_it_comes_home_when_nothing_touches(home):
    command = home + np.deg2rad(0.3)
    for _ in range(300):
        command = LAW.step(command, home, None, 0.7)
    assert np.abs(command - home).max() < np.deg2rad(0.03)


def test_without_return_stiffness_it_stays_where_it_is():
    law = AdmittanceLaw(ARM, REACH, AdmittanceSettings(return_stiffness_n_m_rad=0.0))
    command = np.full(8, 0.05)
    assert law.step(command, np.zeros(8), None, 1.0) is command


angles_admittance_reach = st.lists(st.floats(-1.5, 1.5), min_size=8, max_size=8).map(np.array)


@given(angles_admittance_reach)
def test_no_joint_bends_farther_than_its_limit(command):
    reach = Reach(ARM, np.deg2rad(90.0))
    nearest = reach.nearest(command)
    assert reach.holds(nearest)
    assert (kinematics.bend_rad(nearest) < ARM.bend_limit_rad).all()
    assert np.all(reach.radius_rad < ARM.bend_limit_rad)


@given(angles_admittance_reach, angles_admittance_reach)
def test_it_is_the_nearest_point(command, other):
    reach = Reach(ARM, 0.2)
    nearest, inside = reach.nearest(command), reach.nearest(other)
    assert (command - nearest) @ (inside - nearest) <= 1e-9


@given(angles_admittance_reach)
def test_what_is_within_reach_stays(command):
    reach = Reach(ARM, 0.2)
    inside = reach.nearest(command) * 0.99
    assert np.array_equal(reach.nearest(inside), inside)


FORCE = np.array([0.0, 3.0, 4.0])


def filled(samples, period_ms=10):
    average = ForceAverage(0.2)
    for k, (segment, force) in enumerate(samples):
        average.add(1_000_000 * period_ms * k, segment, force)
    return average


def test_samples_span_the_time_from_the_first_to_the_last():
    assert not filled([(3, FORCE)] * 10).spans(0.1)
    assert filled([(3, FORCE)] * 11).spans(0.1)


def test_slow_sensors_give_three_samples_at_least():
    assert not filled([(3, FORCE)] * 2, period_ms=150).spans(0.1)
    assert filled([(3, FORCE)] * 3, period_ms=150).spans(0.1)


def test_the_mean_of_equal_samples_is_the_sample_and_it_begins_anew():
    average = filled([(3, FORCE)] * 11)
    segment, mean = average.take()
    assert segment == 3
    assert mean == pytest.approx(FORCE)
    assert not average.spans(0.1)


def test_samples_without_contact_or_on_another_segment_weaken_it():
    segment, mean = filled([(3, FORCE)] * 6 + [(0, np.zeros(3))] * 4 + [(2, FORCE)] * 2).take()
    assert segment == 3
    assert mean == pytest.approx(0.5 * FORCE)


def test_no_contact_in_any_sample_is_no_contact():
    segment, mean = filled([(0, np.zeros(3))] * 11).take()
    assert segment == 0
    assert not mean.any()


@pytest.mark.parametrize("stamp_ns", [400_000_000, 90_000_000])
def test_a_gap_or_a_stamp_that_goes_back_begins_anew(stamp_ns):
    average = filled([(3, FORCE)] * 11)
    average.add(stamp_ns, 3, FORCE)
    assert not average.spans(0.1)
