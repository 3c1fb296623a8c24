"""Where wall and arm meet: touching at advance 0, and the arm's compliance as statics has it.

The wall: Hooke with damping, never a pull, and in one update at rest with an elastic arm.

The loop of law, wall and arm at rest: monotone below the assumed stiffness, not far above.
"""

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_base import CableSenseError
from cablesense_online.admittance.law import AdmittanceLaw, AdmittanceSettings, Reach
from cablesense_online.admittance.wall import (
    Approach,
    ElasticWall,
    WallPressing,
    compliance_m_n,
    wall_beside,
)
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.kinematics import contact_points_m

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from admittance import run_loop

POSE = np.deg2rad([3.0, -2.0, 1.0, 4.0, -3.0, 2.0, 0.0, 1.0])


@pytest.mark.parametrize("segment", [1, 2, 3, 4])
@pytest.mark.parametrize("arm", ["cdsm", "cdsm_lab"])
def test_compliance_is_how_far_a_small_push_moves_the_contact(arm, segment):
    mechanism = mechanism_of(open_arm(arm))
    wall = wall_beside(mechanism, POSE, segment, 130.0, 1e4, 0.0)
    forces = np.zeros((4, 3))
    forces[segment - 1] = 0.1 * wall.normal
    moved = [
        contact_points_m(mechanism, rest.joint_angles_rad)[segment - 1]
        for rest in (solve_equilibrium(mechanism, POSE, f) for f in (forces, -forces))
    ]
    expected = wall.normal @ (moved[0] - moved[1]) / 0.2
    assert compliance_m_n(mechanism, POSE, segment, wall.normal) == pytest.approx(
        expected, rel=1e-4
    )


def test_a_wall_touches_at_advance_zero_and_pushes_along_the_contact_angle():
    mechanism = mechanism_of(open_arm("cdsm"))
    wall = wall_beside(mechanism, np.zeros(8), 3, 90.0, 1e4, 0.0)
    point = contact_points_m(mechanism, np.zeros(8))[2]
    assert np.allclose(wall.normal, [0.0, 1.0, 0.0])
    pressing = WallPressing(wall, 0.0)
    assert not pressing.update(point, 0.0, 0.01).any()
    assert np.allclose(pressing.update(point, 0.002, 0.01), 20.0 * wall.normal)


def test_a_segment_that_is_not_there_is_refused():
    mechanism = mechanism_of(open_arm("cdsm"))
    with pytest.raises(CableSenseError, match="segment"):
        wall_beside(mechanism, np.zeros(8), 5, 0.0, 1e4, 0.0)


NORMAL = np.array([0.0, 0.6, 0.8])
POINT = np.array([0.3, 0.0, 0.0])


def wall(stiffness=1e4, damping=0.0):
    return ElasticWall(POINT, NORMAL, stiffness, damping)


@given(st.floats(1.0, 1e6), st.floats(0.0, 0.01), st.floats(-0.05, 0.05))
def test_on_a_rigid_arm_force_is_stiffness_times_penetration(stiffness, advance, aside):
    sideways = aside * np.array([1.0, 0.8, -0.6])
    force = WallPressing(wall(stiffness), 0.0).update(POINT + sideways, advance, 0.01)
    assert force == pytest.approx(stiffness * advance * NORMAL, abs=1e-5)


@given(st.lists(st.floats(-0.01, 0.01), min_size=1), st.floats(0.0, 1e4), st.floats(0.0, 1e-4))
def test_it_never_pulls_and_does_not_act_from_afar(advances, damping, compliance):
    pressing = WallPressing(wall(damping=damping), compliance)
    for advance in advances:
        before = pressing.force_n
        force = pressing.update(POINT, advance, 0.01)
        assert force @ NORMAL >= 0.0
        if advance <= 0.0 and not before:
            assert not force.any()


def test_damping_adds_while_it_closes_and_takes_away_while_it_opens():
    pressing = WallPressing(wall(1000.0, 50.0), 0.0)
    assert pressing.update(POINT, 0.010, 0.1) @ NORMAL == pytest.approx(10.0 + 5.0)
    assert pressing.update(POINT, 0.010, 0.1) @ NORMAL == pytest.approx(10.0)
    assert pressing.update(POINT, 0.008, 0.1) @ NORMAL == pytest.approx(8.0 - 1.0)
    assert pressing.update(POINT, 0.001, 0.01) @ NORMAL == 0.0


@given(st.floats(100.0, 1e6), st.floats(1e-8, 1e-3), st.floats(1e-4, 0.01))
def test_against_an_elastic_arm_one_update_finds_the_equilibrium(stiffness, compliance, advance):
    """Springs in series: F = advance / (1/k + c), whatever the wall pressed with before."""
    pressing = WallPressing(wall(stiffness), compliance)
    expected = advance / (1.0 / stiffness + compliance)
    for _ in range(3):
        point = POINT + compliance * pressing.force_n * NORMAL
        force = pressing.update(point, advance, 0.0)
        if pressing.force_n:
            assert pressing.force_n == pytest.approx(expected, rel=1e-6)
    assert np.allclose(force, pressing.force_n * NORMAL)


def test_the_wall_lets_go_at_once_when_the_arm_has_left_it():
    pressing = WallPressing(wall(), 1e-5)
    assert pressing.update(POINT, 0.003, 0.01).any()
    assert not pressing.update(POINT + 0.004 * NORMAL, 0.003, 0.01).any()


def test_it_approaches_at_its_speed_stops_and_returns():
    approach = Approach(-0.005, 0.01)
    assert approach.towards(0.003, 0.5) == pytest.approx(0.0)
    assert approach.towards(0.003, 0.5) == pytest.approx(0.003)
    assert approach.towards(0.003, 0.5) == pytest.approx(0.003)
    assert approach.towards(-0.005, 0.1) == pytest.approx(0.002)


STIFF, COMPLIANT = (mechanism_of(open_arm(name)) for name in ("cdsm", "cdsm_lab"))
PERIOD_S = 0.7
LIMIT_RAD = float(np.deg2rad(15.0))


def run(mechanism, law_settings, home, segment, angle_deg, stiffness, force_n, steps, tilt_deg=0):
    """Press so that the wall would hold `force_n` against the arm without controller."""
    law = AdmittanceLaw(mechanism, Reach(mechanism, LIMIT_RAD), law_settings)
    unloaded = solve_equilibrium(mechanism, home).joint_angles_rad
    wall = wall_beside(mechanism, unloaded, segment, angle_deg, stiffness, 0.0)
    if tilt_deg:
        axis = np.cross(wall.normal, [0.0, 0.0, 1.0])
        axis = axis / np.linalg.norm(axis) if np.linalg.norm(axis) > 0.1 else np.eye(3)[1]
        turn = np.deg2rad(tilt_deg)
        normal = np.cos(turn) * wall.normal + np.sin(turn) * np.cross(axis, wall.normal)
        wall = ElasticWall(wall.point_m, normal, stiffness)
    compliance = compliance_m_n(mechanism, home, segment, wall.normal)
    advance = force_n * (1.0 / stiffness + compliance)
    return run_loop(mechanism, law, wall, segment, home, advance, steps, PERIOD_S)


def _force_without_slack_n(mechanism, home, segment, angle_deg):
    """The largest force on a segment under which every cable stays taut, to half a newton."""
    normal = wall_beside(mechanism, home, segment, angle_deg, 1e4, 0.0).normal
    forces = np.zeros((80, mechanism.segment_count, 3))
    forces[:, segment - 1] = 0.5 * np.arange(80)[:, None] * normal
    slack = (solve_equilibrium(mechanism, home, forces).tensions_n <= 0.0).any(axis=1)
    return 0.5 * float(np.argmax(slack)) - 0.5 if slack.any() else np.inf


poses = st.lists(st.floats(-6.0, 6.0), min_size=8, max_size=8).map(np.deg2rad)


@pytest.mark.slow
@settings(max_examples=5, deadline=None)
@given(
    st.sampled_from([STIFF, COMPLIANT]),
    poses,
    st.integers(1, 4),
    st.floats(0.0, 360.0),
    st.floats(2_000.0, 20_000.0),
    st.floats(5.0, 40.0),
)
def test_up_to_the_assumed_stiffness_the_force_only_falls(
    mechanism, home, segment, angle, stiffness, force
):
    """Once no cable is slack: before, the arm springs back as far as it is relieved."""
    law_settings = AdmittanceSettings(step_limit_rad=float(np.deg2rad(10.0)))
    forces, commands = run(mechanism, law_settings, home, segment, angle, stiffness, force, 25)
    assert forces[0] > 0.5 * force
    limit_n = _force_without_slack_n(mechanism, home, segment, angle)
    taut = int((forces > limit_n).sum())
    assert np.all(forces[:taut] <= 1.05 * forces[0])
    assert np.all(np.diff(forces[taut:]) <= 0.02)
    moved = np.linalg.norm(commands[-1] - home)
    lever = 0.065  # the shortest of any segment, so the largest share of the return spring
    rest = 2.0 + moved / lever + 1.0  # deadband, spring, and steps too small to be taken
    to_go = (1.0 - 0.9 * stiffness / 25_000.0) ** 25 if mechanism is STIFF else 0.5
    assert forces[-1] <= rest + force * to_go


@pytest.mark.slow
@settings(max_examples=4, deadline=None)
@given(poses, st.integers(1, 4), st.floats(0.0, 360.0), st.floats(22_000.0, 36_000.0))
def test_up_to_twice_the_assumed_stiffness_it_may_overshoot_but_comes_to_rest(
    home, segment, angle, stiffness
):
    forces, _ = run(STIFF, AdmittanceSettings(), home, segment, angle, stiffness, 30.0, 30)
    assert forces[-1] <= 6.0
    assert np.ptp(forces[-10:]) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("segment", [1, 2, 3, 4])
def test_far_beyond_the_bound_it_chatters(segment):
    """Off the wall at once, and back onto it harder than the deadband: a gain of six."""
    hasty = AdmittanceSettings(return_stiffness_n_m_rad=20.0, touch_n=1_000.0)
    forces, _ = run(STIFF, hasty, np.zeros(8), segment, 90.0, 120_000.0, 60.0, 20)
    assert forces[1] == 0.0
    assert forces[1:].max() > 10.0


@pytest.mark.slow
def test_an_arm_softer_than_the_wall_makes_the_loop_calm_again():
    """Arm and wall are springs in series: the loop sees k / (1 + k c)."""
    forces, _ = run(COMPLIANT, AdmittanceSettings(), np.zeros(8), 4, 90.0, 120_000.0, 30.0, 40)
    assert np.all(np.diff(forces) <= 0.02)
    assert forces[-1] < 6.0


@pytest.mark.slow
@settings(max_examples=6, deadline=None)
@given(poses, st.integers(2, 4), st.floats(0.0, 360.0), st.floats(-20.0, 20.0))
def test_a_wall_that_leans_by_20_degrees_is_left_as_calmly(home, segment, angle, tilt):
    forces, _ = run(STIFF, AdmittanceSettings(), home, segment, angle, 12_000.0, 30.0, 20, tilt)
    assert np.all(np.diff(forces) <= 0.05)
    assert forces[-1] < 10.0


def test_the_measured_gain_is_the_one_the_law_states():
    law_settings = AdmittanceSettings(
        return_stiffness_n_m_rad=0.0, step_limit_rad=1.0, speed_limit_rad_s=10.0, deadband_n=0.5
    )
    law = AdmittanceLaw(STIFF, Reach(STIFF, LIMIT_RAD), law_settings)
    for segment in (1, 2, 3, 4):
        forces, _ = run(STIFF, law_settings, np.zeros(8), segment, 90.0, 10_000.0, 10.0, 2)
        excess = forces - 0.5
        stated = law.loop_gain(np.zeros(8), segment, np.eye(3)[1], 10_000.0, PERIOD_S)
        assert 1.0 - excess[1] / excess[0] == pytest.approx(stated, rel=0.03)
