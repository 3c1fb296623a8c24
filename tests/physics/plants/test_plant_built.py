"""Arms as built: drawn errors have the stated deviations, and pushes act anywhere by statics."""

from dataclasses import astuple, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_plants.arm.arm import ideal_arm
from cablesense_plants.arm.body import PlantError
from cablesense_plants.arm.built import BuiltArm, Push, Workmanship
from cablesense_plants.arm.statics import cable_lengths_m, find_rest, frames, turns
from tests.helpers.plant_arm import BODY, NOMINAL

ALONG = np.array([1.0, 0.0, 0.0])
FORCE_N = np.array([3.0, 12.0, -9.0])
FINE = Workmanship()
GRAVITY_M_S2 = np.linalg.norm(BODY.gravity_m_s2)
PERFECT = FINE.scaled(0.0)
POSE = np.deg2rad([8.0, -4.0, 6.0, 5.0, -7.0, 3.0, 4.0, -6.0])
SEGMENTS = NOMINAL.segment_count
PUSHES = [
    Push(2, 0.03, FORCE_N),
    Push(4, 0.14, np.array([-20.0, 4.0, 6.0]), np.array([0.5, 0.02, -0.05])),
    Push(2, -0.01, np.array([8.0, 0.0, 0.0]), np.array([0.0, 0.05, 0.0])),
]


def arm_of(workmanship=FINE, seed=0, **friction):
    return BuiltArm(NOMINAL, workmanship, np.random.default_rng(seed), **friction)


def outer_torques_nm(arm, angles_rad):
    """(8,) all but the cables' that rest needs, by the tensions and lengths' differences."""
    tensions_n = arm.tensions_n(POSE, PUSHES)
    step_rad = 1e-6
    ahead_m = cable_lengths_m(arm.body, angles_rad + step_rad * np.eye(8))
    back_m = cable_lengths_m(arm.body, angles_rad - step_rad * np.eye(8))
    return (ahead_m - back_m) / (2.0 * step_rad) @ tensions_n


def test_without_errors_it_is_the_arm_as_drawn() -> None:
    arm = arm_of(PERFECT)
    held_m = ideal_arm(NOMINAL).held_m(POSE[None])
    loads_n = np.zeros((1, SEGMENTS, 3))
    loads_n[0, 2] = FORCE_N
    drawn = find_rest(BODY, POSE[None], held_m, loads_n)
    pushed = arm.tensions_n(POSE, [Push(3, NOMINAL.contact_m[2], FORCE_N)])
    np.testing.assert_allclose(pushed, drawn.tensions_n[0], atol=1e-6)


def test_readings_have_gain_and_zero_and_are_whole_steps() -> None:
    arm = arm_of()
    tensions_n = np.tile(arm.tensions_n(POSE), (2000, 1))
    readings_n = arm.read(tensions_n, np.random.default_rng(1))
    steps = readings_n / NOMINAL.step_n
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    errors_n = readings_n - (arm.gains * tensions_n + arm.zeros_n)
    assert np.sqrt((errors_n**2).mean()) == pytest.approx(NOMINAL.floor_n, rel=0.1)
    perfect_n = arm_of(PERFECT).read(tensions_n, np.random.default_rng(1))
    assert np.abs(readings_n - perfect_n).max() > NOMINAL.step_n


@pytest.mark.parametrize("segment", range(1, SEGMENTS + 1))
def test_a_push_at_the_contact_point_is_the_plant_s_own_load(segment: int) -> None:
    arm = arm_of()
    loads_n = np.zeros((1, SEGMENTS, 3))
    loads_n[0, segment - 1] = FORCE_N
    rest_under_load = find_rest(arm.body, POSE[None], arm.held_m(POSE[None]), loads_n)
    pushed = arm.tensions_n(POSE, [Push(segment, NOMINAL.contact_m[segment - 1], FORCE_N)])
    np.testing.assert_allclose(pushed, rest_under_load.tensions_n[0], atol=1e-6)


def test_tensions_balance_weights_and_pushes_at_every_joint() -> None:
    """Virtual work: the moment about each joint axis of all that lies beyond the joint."""
    arm = arm_of()
    rest = arm.rests(POSE[None], [PUSHES])
    body = arm.body
    placed = frames(body, rest.angles_rad, turns(body, rest.angles_rad))
    rotation = placed.rotation[0]
    centre_m = placed.centre_m[0]
    acting = [
        (joint, at_m, mass_kg * body.gravity_m_s2)
        for joint, at_m, mass_kg in zip(body.mass_joint, body.mass_at_m, body.mass_kg, strict=True)
    ]
    for push in PUSHES:
        at_m = push.place_m * ALONG
        if push.at_side_m is not None:
            at_m = at_m + push.at_side_m * [0.0, 1.0, 1.0]
        acting.append((push.segment - 1, at_m, push.force_n))
    moments_nm = np.zeros(8)
    for joint, at_m, force_n in acting:
        point_m = centre_m[joint] + rotation[joint] @ at_m
        for angle in range(2 * joint + 2):
            lever_m = point_m - centre_m[angle // 2]
            moments_nm[angle] += placed.axis[0, angle] @ np.cross(lever_m, force_n)
    np.testing.assert_allclose(outer_torques_nm(arm, rest.angles_rad), moments_nm, atol=1e-6)


@pytest.mark.parametrize("segment", range(1, SEGMENTS))
def test_the_end_of_a_segment_is_the_next_joint(segment: int) -> None:
    arm = arm_of()
    length_m = arm.body.spacing_m[segment]
    assert length_m != NOMINAL.length_m[segment - 1]
    end = arm.tensions_n(POSE, [Push(segment, length_m, FORCE_N)])
    joint = arm.tensions_n(POSE, [Push(segment + 1, 0.0, FORCE_N)])
    np.testing.assert_allclose(end, joint, atol=1e-6)


@given(st.floats(-0.02, 0.15), st.integers(1, SEGMENTS), st.floats(-0.05, 0.05))
def test_forces_at_the_corners_have_the_push_s_force_and_moment(
    place_m: float, segment: int, side_m: float
) -> None:
    arm = arm_of()
    side = np.array([0.3, side_m, -0.02])
    loads_n = arm.corner_loads_n([Push(segment, place_m, FORCE_N, side)]).reshape(4, SEGMENTS, 3)
    length_m = NOMINAL.length_m[segment - 1]
    corners_m = np.vstack([np.zeros(3), length_m * np.eye(3)])
    beside = np.arange(SEGMENTS) != segment - 1
    assert not loads_n[:, beside].any()
    np.testing.assert_allclose(loads_n.sum(axis=(0, 1)), FORCE_N, atol=1e-12)
    moment_nm = np.cross(corners_m, loads_n[:, segment - 1]).sum(axis=0)
    expected_nm = np.cross([place_m, side_m, -0.02], FORCE_N)
    np.testing.assert_allclose(moment_nm, expected_nm, atol=1e-12)


def test_an_axial_push_beside_the_axis_bends_the_arm_by_its_moment() -> None:
    """As far as the arm is stiff, like the couple of two opposite pushes across it."""
    arm = arm_of(FINE.scaled(0.5))
    segment = 3
    axes = arm.axes(POSE)[segment - 1]
    along_n = 0.6 * axes[:, 0]
    across_n = axes[:, 2]
    side_m = np.array([0.0, 0.0, 0.05])
    beside = arm.tensions_n(POSE, [Push(segment, 0.06, along_n, side_m)])
    on_axis = Push(segment, 0.06, along_n)
    lever_m = 0.05 * 0.6
    couple = [Push(segment, 0.06, across_n), Push(segment, 0.06 + lever_m, -across_n)]
    equal = arm.tensions_n(POSE, [on_axis, *couple])
    free = arm.tensions_n(POSE, [on_axis])
    assert np.abs(beside - free).max() > 0.1
    np.testing.assert_allclose(beside, equal, atol=1e-3)


def test_errors_have_the_stated_deviations() -> None:
    rng = np.random.default_rng(7)
    arms = [BuiltArm(NOMINAL, FINE, rng) for _ in range(200)]
    bodies = [arm.body for arm in arms]

    def differences(name):
        return np.array([getattr(body, name) for body in bodies]) - getattr(BODY, name)

    def polar(name):
        y, z = np.moveaxis(np.array([getattr(body, name) for body in bodies])[..., 1:], -1, 0)
        drawn_y, drawn_z = np.moveaxis(getattr(BODY, name)[..., 1:], -1, 0)
        turn_rad = np.angle((z + 1j * y) / (drawn_z + 1j * drawn_y))
        return np.hypot(y, z) - NOMINAL.radius_m, turn_rad * NOMINAL.radius_m

    gravity = np.array([body.gravity_m_s2 for body in bodies])
    level = np.linalg.norm(np.cross(gravity, BODY.gravity_m_s2), axis=1)
    tilt_deg = np.rad2deg(level / GRAVITY_M_S2**2)
    before = polar("before_m")
    after = polar("after_m")
    for errors, stated in [
        (differences("stiffness_n_m") / BODY.stiffness_n_m, FINE.cable_stiffness_share),
        (differences("pretension_n"), FINE.pretension_n),
        (differences("mass_kg") / BODY.mass_kg, FINE.segment_mass_share),
        (differences("mass_at_m"), FINE.centre_of_mass_m),
        (before[0], FINE.hole_radial_m),
        (before[1], FINE.hole_around_m),
        (after[0], FINE.hole_radial_m),
        (after[1], FINE.hole_around_m),
        (differences("spacing_m")[:, 1:], FINE.segment_length_m),
        (differences("tip_at_m")[:, 0], FINE.segment_length_m),
        (np.array([arm.gains for arm in arms]) - 1.0, FINE.sensor_gain_share),
        (np.array([arm.zeros_n for arm in arms]), FINE.sensor_zero_n),
        (np.rad2deg([arm.joint_zero_rad for arm in arms]), FINE.joint_zero_deg),
        (tilt_deg, FINE.base_tilt_deg),
    ]:
        assert np.sqrt((errors**2).mean()) == pytest.approx(stated, rel=4.0 / errors.size**0.5)
    for one, other in zip(before, after, strict=True):
        np.testing.assert_allclose(one[:, 1:], other[:, :-1], atol=1e-15)
        bare = np.concatenate([one[:, :1], other], axis=1).reshape(200, -1)
        between = np.corrcoef(bare.T) - np.eye(bare.shape[1])
        assert np.abs(between).max() < 5.0 / np.sqrt(200.0)
    np.testing.assert_allclose(np.linalg.norm(gravity, axis=1), GRAVITY_M_S2)
    mean_gravity = gravity.mean(axis=0)
    spread = GRAVITY_M_S2 * np.deg2rad(FINE.base_tilt_deg)
    np.testing.assert_allclose(mean_gravity, BODY.gravity_m_s2, atol=5.0 * spread / 200.0**0.5)


def test_the_same_seed_with_other_workmanship_draws_the_same_errors_at_another_scale() -> None:
    once = arm_of()
    thrice = arm_of(FINE.scaled(3.0))
    grown_n = thrice.body.pretension_n - BODY.pretension_n
    np.testing.assert_allclose(grown_n, 3.0 * (once.body.pretension_n - BODY.pretension_n))
    np.testing.assert_allclose(thrice.joint_zero_rad, 3.0 * once.joint_zero_rad)
    assert astuple(FINE.scaled(3.0)) == pytest.approx([3.0 * each for each in astuple(FINE)])


def test_rests_of_many_commands_are_those_of_each() -> None:
    arm = arm_of()
    commands = np.outer([1.0, -0.5, 0.0], POSE)
    pushes = [PUSHES, (), PUSHES[:1]]
    many = arm.rests(commands, pushes).tensions_n
    for command, row, tensions_n in zip(commands, pushes, many, strict=True):
        np.testing.assert_allclose(arm.tensions_n(command, row), tensions_n, atol=1e-6)


def test_what_cannot_be_is_refused() -> None:
    arm = arm_of()
    with pytest.raises(PlantError, match="segment 5; the arm has 1 to 4"):
        arm.tensions_n(POSE, [Push(5, 0.1, FORCE_N)])
    with pytest.raises(PlantError, match=r"no rest|bends by"):
        arm.tensions_n(POSE, [Push(4, 0.1, 200.0 * FORCE_N)])
    with pytest.raises(PlantError, match="a negative pretension"):
        arm_of(replace(FINE, pretension_n=1000.0))


def test_a_walk_without_friction_forgets_its_way() -> None:
    arm = arm_of()
    walk = arm.walk(np.zeros(8))
    walk.go(0.5 * POSE, [Push(3, 0.05, FORCE_N)])
    np.testing.assert_allclose(walk.go(POSE, PUSHES), arm.tensions_n(POSE, PUSHES), atol=1e-4)


@pytest.mark.slow
def test_a_walk_with_friction_keeps_its_tensions_when_a_load_is_lifted() -> None:
    """Until cable slips back over the pulley; with a coefficient of 0.1 the bound is e^±0.1."""
    arm = arm_of(friction=0.1)
    walk = arm.walk(0.6 * POSE)
    free_n = walk.go(POSE)
    start = walk.state
    pushed_n = walk.go(POSE, [Push(4, 0.1, 1.5 * FORCE_N)])
    assert np.abs(walk.state.loads_n).max() > 0.0
    lifted_n = walk.go(POSE)
    assert not np.array_equal(walk.state.angles_rad, start.angles_rad)
    assert np.abs(lifted_n - free_n).max() > 0.3
    assert np.abs(pushed_n - free_n).max() > 3.0
    pulley = np.abs(np.log(walk.state.tension_n[:, 1] / walk.state.tension_n[:, 0]))
    assert pulley.max() <= 0.1 + 1e-6
    with pytest.raises(PlantError):
        walk.go(POSE, [Push(4, 0.1, 200.0 * FORCE_N)])
    np.testing.assert_array_equal(walk.tensions_n, lifted_n)
