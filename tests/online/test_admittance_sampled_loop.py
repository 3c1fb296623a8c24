"""The loop of law, wall and arm at rest: monotone below the assumed stiffness, not far above."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_online.admittance.law import AdmittanceLaw, AdmittanceSettings, Reach
from cablesense_online.admittance.wall import ElasticWall, SampledLoop, compliance_m_n, wall_beside
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium

STIFF, COMPLIANT = (mechanism_of(open_arm(name)) for name in ("cdsm", "cdsm_lab"))
PERIOD_S = 0.7
LIMIT_RAD = float(np.deg2rad(15.0))


def run(mechanism, law_settings, home, segment, angle_deg, stiffness, force_n, steps, tilt_deg=0):
    """Press so that the wall would hold `force_n` against the arm without controller."""
    law = AdmittanceLaw(mechanism, Reach.of(mechanism, LIMIT_RAD), law_settings)
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
    return SampledLoop(mechanism, law, wall, segment).run(home, advance, steps, PERIOD_S)


poses = st.lists(st.floats(-6.0, 6.0), min_size=8, max_size=8).map(np.deg2rad)


@pytest.mark.slow
@settings(max_examples=8, deadline=None)
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
    law_settings = AdmittanceSettings(step_limit_rad=float(np.deg2rad(10.0)))
    course = run(mechanism, law_settings, home, segment, angle, stiffness, force, 25)
    assert course.forces_n[0] > 0.5 * force
    assert np.all(np.diff(course.forces_n) <= 0.02)
    moved = np.linalg.norm(course.commands_rad[-1] - home)
    lever = 0.065  # the shortest of any segment, so the largest share of the return spring
    rest = 2.0 + moved / lever + 1.0  # deadband, spring, and steps too small to be taken
    to_go = (1.0 - 0.9 * stiffness / 25_000.0) ** 25 if mechanism is STIFF else 0.5
    assert course.forces_n[-1] <= rest + force * to_go


@pytest.mark.slow
@settings(max_examples=8, deadline=None)
@given(poses, st.integers(1, 4), st.floats(0.0, 360.0), st.floats(22_000.0, 36_000.0))
def test_up_to_twice_the_assumed_stiffness_it_may_overshoot_but_comes_to_rest(
    home, segment, angle, stiffness
):
    course = run(STIFF, AdmittanceSettings(), home, segment, angle, stiffness, 30.0, 30)
    assert course.forces_n[-1] <= 6.0
    assert np.ptp(course.forces_n[-10:]) < 0.5


@pytest.mark.parametrize("segment", [1, 2, 3, 4])
def test_far_beyond_the_bound_it_chatters(segment):
    """Off the wall at once, and back onto it harder than the deadband: a gain of six."""
    hasty = AdmittanceSettings(return_stiffness_n_m_rad=20.0, touch_n=1_000.0)
    course = run(STIFF, hasty, np.zeros(8), segment, 90.0, 120_000.0, 60.0, 20)
    assert course.forces_n[1] == 0.0
    assert course.forces_n[1:].max() > 10.0


def test_an_arm_softer_than_the_wall_makes_the_loop_calm_again():
    """Arm and wall are springs in series: the loop sees k / (1 + k c)."""
    course = run(COMPLIANT, AdmittanceSettings(), np.zeros(8), 4, 90.0, 120_000.0, 30.0, 40)
    assert np.all(np.diff(course.forces_n) <= 0.02)
    assert course.forces_n[-1] < 6.0


@pytest.mark.slow
@settings(max_examples=6, deadline=None)
@given(poses, st.integers(2, 4), st.floats(0.0, 360.0), st.floats(-20.0, 20.0))
def test_a_wall_that_leans_by_20_degrees_is_left_as_calmly(home, segment, angle, tilt):
    course = run(STIFF, AdmittanceSettings(), home, segment, angle, 12_000.0, 30.0, 20, tilt)
    assert np.all(np.diff(course.forces_n) <= 0.05)
    assert course.forces_n[-1] < 10.0


def test_the_measured_gain_is_the_one_the_law_states():
    law_settings = AdmittanceSettings(
        return_stiffness_n_m_rad=0.0, step_limit_rad=1.0, speed_limit_rad_s=10.0, deadband_n=0.5
    )
    law = AdmittanceLaw(STIFF, Reach.of(STIFF, LIMIT_RAD), law_settings)
    for segment in (1, 2, 3, 4):
        course = run(STIFF, law_settings, np.zeros(8), segment, 90.0, 10_000.0, 10.0, 2)
        excess = course.forces_n - 0.5
        stated = law.loop_gain(np.zeros(8), segment, np.eye(3)[1], 10_000.0, PERIOD_S)
        assert 1.0 - excess[1] / excess[0] == pytest.approx(stated, rel=0.03)
