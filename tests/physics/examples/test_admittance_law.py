"""The law is passive and keeps its limits; the sampled loop of law, wall and arm is as derived."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rclpy")

from admittance import run_loop

from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import normal_force_n
from examples.admittance.law import AdmittanceLaw, AdmittanceSettings, ContactForce
from examples.admittance.wall import ElasticWall, wall_beside

STIFF, COMPLIANT = (mechanism_of(open_arm(name)) for name in ("cdsm", "cdsm_lab"))
DEFAULT = AdmittanceSettings()
LAW = AdmittanceLaw(STIFF, DEFAULT)
UNLIMITED = AdmittanceLaw(
    STIFF, AdmittanceSettings(step_limit_deg=600.0, speed_limit_deg_s=6000.0, touch_n=1e9)
)
PERIOD_S = 0.7

poses = st.lists(st.floats(-5.0, 5.0), min_size=8, max_size=8).map(np.deg2rad)
segments = st.integers(1, 4)
angles = st.floats(0.0, 360.0)


def contact_force(command, segment, angle_deg, magnitude_n):
    force = normal_force_n(STIFF, command, segment, angle_deg, magnitude_n)[segment - 1]
    return ContactForce(segment, force)


def contact_jacobian(command, segment):
    return kinematics.contact_jacobians_m(STIFF, command)[segment - 1]


@pytest.mark.slow
@given(poses, poses, segments, angles, st.floats(0.0, 500.0), st.floats(0.05, 5.0))
def test_limits_hold_whatever_the_contact(command, home, segment, angle, magnitude, elapsed):
    for contact in (None, contact_force(command, segment, angle, magnitude)):
        target = LAW.step(command, home, contact, elapsed)
        limit = np.deg2rad(min(DEFAULT.step_limit_deg, DEFAULT.speed_limit_deg_s * elapsed))
        assert np.abs(target - command).max() <= limit + 1e-12
        assert LAW.holds(target)


@pytest.mark.slow
@given(poses, poses, segments, angles, st.floats(0.0, 100.0), st.floats(0.05, 1.0))
def test_it_takes_no_more_energy_from_the_contact_than_it_stores(
    command, home, segment, angle, magnitude, elapsed
):
    """Passivity: the work of the contact is at least what the return spring gains."""
    contact = contact_force(command, segment, angle, magnitude)
    step = UNLIMITED.step(command, home, contact, elapsed) - command
    if not UNLIMITED.holds(command + 1.001 * step):
        return  # the edge of the reach holds against the spring, which the next test covers
    work = contact.force_base_n @ contact_jacobian(command, segment) @ step
    away = command - home
    gained = 0.5 * ((away + step) @ (away + step) - away @ away)
    assert work >= gained * DEFAULT.return_stiffness_n_m_rad - 1e-9


@given(poses, segments, angles, st.floats(3.0, 500.0))
def test_the_edge_of_the_reach_never_reverses_a_step(command, segment, angle, magnitude):
    command = LAW.nearest(4.0 * command)
    contact = contact_force(command, segment, angle, magnitude)
    step = LAW.step(command, command, contact, 1.0) - command
    assert contact.force_base_n @ contact_jacobian(command, segment) @ step >= -1e-12


@pytest.mark.parametrize("magnitude", [0.0, 1.0, 1.999])
def test_a_force_within_the_deadband_moves_nothing_at_home(magnitude):
    home = np.full(8, 0.02)
    assert LAW.step(home, home, contact_force(home, 3, 40.0, magnitude), 1.0) is home


def test_a_step_solves_the_law():
    """The linear system of the module's docstring, solved by a library."""
    command = np.deg2rad(np.linspace(-3, 4, 8))
    home = np.full(8, 0.01)
    contact = contact_force(command, 3, 77.0, 30.0)
    j = contact_jacobian(command, 3).T @ (contact.force_base_n / 30.0)
    tau = 30.0 * j - (command - home)
    tau *= 1.0 - 2.0 * np.linalg.norm(j) / np.linalg.norm(tau)
    matrix = (5.0 / PERIOD_S + 1.0) * np.eye(8) + 20_000.0 * np.outer(j, j)
    expected = command + np.linalg.solve(matrix, tau)
    assert np.allclose(UNLIMITED.step(command, home, contact, PERIOD_S), expected, atol=1e-12)


@given(poses, poses)
def test_the_way_home_never_meets_a_wall_with_more_than_the_touch(command, home):
    step = LAW.step(command, home, None, 1.0) - command
    moved_m = np.linalg.norm(kinematics.contact_jacobians_m(STIFF, command) @ step, axis=-1).max()
    assert moved_m * DEFAULT.worst_stiffness_n_m <= DEFAULT.touch_n * (1.0 + 1e-9)
    assert (command - home) @ step <= 0.0


@given(st.floats(100.0, 1e6), st.floats(1e-8, 1e-3), st.floats(1e-4, 0.01))
def test_the_wall_finds_the_equilibrium_with_an_elastic_arm_and_never_pulls(
    stiffness, compliance, advance
):
    """Springs in series: F = advance / (1/k + c), whatever the wall pressed with before."""
    normal = np.array([0.0, 0.6, 0.8])
    point = np.array([0.3, 0.0, 0.0])
    wall = ElasticWall(point, normal, stiffness, compliance)
    assert not wall.update(point, -advance).any()
    for _ in range(3):
        wall.update(point + compliance * wall.force_n * normal, advance)
        assert wall.force_n == pytest.approx(advance / (1.0 / stiffness + compliance), rel=1e-6)
    assert not wall.update(point + (advance + 0.02) * normal, advance).any()


def run(mechanism, given_settings, segment, stiffness, force_n, steps, home=None, angle_deg=90.0):
    """The forces when the wall would hold `force_n` against the arm without the controller."""
    home = np.zeros(8) if home is None else home
    wall = wall_beside(mechanism, home, segment, angle_deg, stiffness)
    advance_m = force_n * (1.0 / stiffness + wall.compliance_m_n)
    law = AdmittanceLaw(mechanism, given_settings)
    return run_loop(mechanism, law, wall, segment, home, advance_m, steps, PERIOD_S)


@pytest.mark.slow
@settings(max_examples=5, deadline=None)
@given(poses, segments, angles, st.floats(2_000.0, 20_000.0))
def test_up_to_the_expected_stiffness_the_force_only_falls(home, segment, angle, stiffness):
    forces = run(STIFF, DEFAULT, segment, stiffness, 15.0, 12, home, angle)
    assert forces[0] > 7.5
    assert np.all(np.diff(forces) <= 0.02)


@pytest.mark.slow
def test_far_beyond_the_bound_it_chatters_and_a_softer_arm_calms_it():
    hasty = AdmittanceSettings(return_stiffness_n_m_rad=20.0, touch_n=1_000.0)
    forces = run(STIFF, hasty, 3, 120_000.0, 60.0, 12)
    assert forces[1] == 0.0  # thrown off the wall
    assert forces[1:].max() > 10.0
    forces = run(COMPLIANT, DEFAULT, 4, 120_000.0, 30.0, 40)  # it sees k / (1 + k c)
    assert np.all(np.diff(forces) <= 0.02)
    assert forces[-1] < 6.0
