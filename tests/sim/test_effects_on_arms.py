"""Effects that amend the mechanism: closed forms, places, and nothing at size zero."""

from dataclasses import fields

import numpy as np
import pytest
from effect_arms import ARM, MECHANISM, STRAIGHT, bent, course, entry, push, readings
from joint_torques import load_torques_n_m
from scipy.spatial.transform import Rotation

from cablesense_sim import kinematics
from cablesense_sim.effects.registry import EffectEntry, amended
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.mechanism import Mechanism

POSES = np.concatenate([STRAIGHT[None], bent(1, count=4)])
PUSH = push(3, [0.0, 15.0, 10.0])


def rest_of(*entries: EffectEntry, forces: np.ndarray = PUSH):
    """The amended arm, its pose and tensions, while its actuators hold the nominal lengths."""
    mechanism = amended(MECHANISM, entries)
    held = held_lengths_m(MECHANISM, POSES)
    return mechanism, solve_equilibrium(mechanism, POSES, forces, held_m=held)


def unbalanced_n_m(mechanism: Mechanism, rest, forces: np.ndarray) -> np.ndarray:
    """J'T less the torques of weight and loads (B, 8), with the geometry of `mechanism`."""
    jacobian = kinematics.cable_jacobian_m(mechanism, rest.joint_angles_rad)
    forces = np.broadcast_to(forces, (len(POSES), 4, 3))
    torque = load_torques_n_m(mechanism, rest.joint_angles_rad, forces)
    return np.einsum("bmj,bm->bj", jacobian, rest.tensions_n) - torque


ON_ARMS = [
    entry("payload", "segment_2"),
    entry("base_tilt"),
    entry("cable_stiffness", "segment_3"),
    entry("contact_offset", "segment_3"),
    entry("joint_elasticity", "joint_2"),
    entry("pretension_error", "cable_5"),
    entry("routing_geometry", "segment_2"),
    entry("cable_tolerance", "cable_5"),
    entry("segment_tolerance", "segment_3"),
]


@pytest.mark.parametrize("nothing", ON_ARMS, ids=lambda e: e.effect.name)
def test_size_zero_leaves_the_arm_as_it_is(nothing: EffectEntry) -> None:
    same = amended(MECHANISM, [nothing])
    for field in fields(Mechanism):
        before, after = getattr(MECHANISM, field.name), getattr(same, field.name)
        if before is None:
            assert after is None
        else:
            np.testing.assert_allclose(after, before, rtol=1e-14, atol=1e-16, err_msg=field.name)


def test_a_payload_is_its_weight_at_its_place() -> None:
    """J'T of the loaded arm balances the nominal weight and a point weight at that place."""
    mass, beyond = 0.7, 0.15
    _, rest = rest_of(entry("payload", "segment_3", mass_kg=mass, beyond_middle=beyond))
    missing = unbalanced_n_m(MECHANISM, rest, PUSH)
    pose = kinematics.chain(MECHANISM, rest.joint_angles_rad)
    at = pose.joint_m[:, 2] + 0.13 * (0.5 + beyond) * pose.rotation[:, 2, :, 0]
    weight = np.array([0.0, 0.0, -9.81 * mass])
    for joint in range(8):
        lever = at - pose.joint_m[:, joint // 2]
        moment = np.einsum("bi,bi->b", pose.joint_axis[:, joint], np.cross(lever, weight))
        np.testing.assert_allclose(missing[:, joint], moment if joint < 6 else 0.0, atol=1e-6)


def test_a_base_pitched_up_makes_the_arm_hang() -> None:
    """Pitch about y by +90 degrees points the arm down: x is where gravity goes."""
    tilted = amended(MECHANISM, [entry("base_tilt", pitch_rad=0.6)])
    expected = 9.81 * np.array([np.sin(0.6), 0.0, -np.cos(0.6)])
    np.testing.assert_allclose(tilted.gravity_m_s2, expected)
    both = amended(MECHANISM, [entry("base_tilt", roll_rad=0.1, pitch_rad=-0.2)])
    base = Rotation.from_euler("x", 0.1) * Rotation.from_euler("y", -0.2)
    np.testing.assert_allclose(base.apply(both.gravity_m_s2), [0.0, 0.0, -9.81], atol=1e-12)


def test_softer_cables_stretch_more_under_the_same_tension() -> None:
    soft, _ = rest_of(entry("cable_stiffness", "segment_3", change=-0.4))
    scale = soft.stiffness_n_m / MECHANISM.stiffness_n_m
    np.testing.assert_allclose(scale, np.where(MECHANISM.cable_segment == 3, 0.6, 1.0))
    every, rest = rest_of(entry("cable_stiffness", change=-0.4))
    stretch = rest.tensions_n / (0.6 * MECHANISM.stiffness_n_m) - 50.0 / every.stiffness_n_m
    turned = held_lengths_m(MECHANISM, rest.joint_angles_rad) - held_lengths_m(MECHANISM, POSES)
    np.testing.assert_allclose(turned, stretch, atol=1e-9)


@pytest.mark.parametrize(("place", "moved"), [("arm", [1, 1, 1, 1]), ("segment_3", [0, 0, 1, 0])])
def test_a_load_elsewhere_is_a_load_with_another_lever(place: str, moved: list[int]) -> None:
    """Equal forces at two points of a segment differ by a couple, the same all the way down."""
    mechanism, rest = rest_of(entry("contact_offset", place, offset_m=0.02))
    np.testing.assert_allclose(mechanism.contact_m - 0.065, 0.02 * np.array(moved))
    pose = kinematics.chain(MECHANISM, rest.joint_angles_rad)
    couple = np.cross(0.02 * pose.rotation[:, 2, :, 0], PUSH[2])
    missing = unbalanced_n_m(MECHANISM, rest, PUSH)
    for joint in range(8):
        moment = np.einsum("bi,bi->b", pose.joint_axis[:, joint], couple)
        np.testing.assert_allclose(missing[:, joint], moment if joint < 6 else 0.0, atol=1e-6)


@pytest.mark.parametrize(("place", "where"), [("arm", slice(None)), ("joint_2", slice(2, 4))])
def test_springs_take_their_share_of_the_torque(place: str, where: slice) -> None:
    _, rest = rest_of(entry("joint_elasticity", place, stiffness_n_m_rad=12.0))
    expected = np.zeros_like(rest.joint_angles_rad)
    expected[:, where] = -12.0 * rest.joint_angles_rad[:, where]
    np.testing.assert_allclose(unbalanced_n_m(MECHANISM, rest, PUSH), expected, atol=1e-6)


def test_pretension_is_what_a_straight_weightless_arm_carries_where_it_is_balanced() -> None:
    from dataclasses import replace

    weightless = replace(MECHANISM, gravity_m_s2=np.zeros(3))
    tighter = amended(weightless, [entry("pretension_error", error_n=12.0)])
    rest = solve_equilibrium(tighter, STRAIGHT)
    np.testing.assert_allclose(rest.tensions_n, 62.0, atol=1e-9)
    one = amended(weightless, [entry("pretension_error", "cable_12", error_n=12.0)])
    rest = solve_equilibrium(one, STRAIGHT)
    assert 50.0 < rest.tensions_n[11] < 62.0  # the arm gives way
    assert np.abs(rest.tensions_n[:11] - 50.0).max() > 0.1


def test_holes_of_the_own_cables_move_together() -> None:
    moved = amended(
        MECHANISM,
        [entry("routing_geometry", "segment_2", cables_radius_m=0.004, cables_angle_rad=0.1)],
    )
    own = MECHANISM.cable_segment == 2
    radius = np.hypot(moved.hole_y_m, moved.hole_z_m)
    np.testing.assert_allclose(radius, np.where(own, 0.054, 0.05))
    turned = np.arctan2(moved.hole_y_m, moved.hole_z_m) - np.arctan2(
        MECHANISM.hole_y_m, MECHANISM.hole_z_m
    )
    turned = (turned + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(turned, np.where(own, 0.1, 0.0), atol=1e-12)
    assert moved.segment_hole_y_m is None


def test_holes_of_the_own_plates_move_for_every_cable_that_passes() -> None:
    moved = amended(
        MECHANISM,
        [entry("routing_geometry", "segment_2", plates_radius_m=0.004, plates_angle_rad=0.1)],
    )
    np.testing.assert_array_equal(moved.hole_y_m, MECHANISM.hole_y_m)
    assert moved.segment_hole_y_m is not None
    assert moved.segment_hole_z_m is not None
    radius = np.hypot(moved.segment_hole_y_m, moved.segment_hole_z_m)
    np.testing.assert_allclose(radius, np.broadcast_to([0.05, 0.054, 0.05, 0.05], (12, 4)))
    (before_y, _), (after_y, _) = moved.plate_holes_m
    np.testing.assert_array_equal(before_y[:, 0], MECHANISM.hole_y_m)  # the base plate's
    np.testing.assert_array_equal(before_y[:, 1:], after_y[:, :-1])


def test_plates_out_of_line_make_a_cable_longer_by_what_is_seen_in_space() -> None:
    """Spans from holes placed in space by the chain's own rotations."""
    mechanism = amended(
        MECHANISM,
        [
            entry("routing_geometry", "segment_2", plates_radius_m=0.004, plates_angle_rad=0.1),
            entry("routing_geometry", "segment_4", cables_angle_rad=-0.2),
        ],
    )
    pose = kinematics.chain(mechanism, POSES)
    (y, z), (v, w) = (np.broadcast_arrays(*holes) for holes in mechanism.plate_holes_m)
    span = kinematics.spans(mechanism, POSES).length_m
    for cable, joint in ((0, 0), (5, 1), (10, 1), (11, 2), (9, 3)):
        turn = pose.rotation[:, joint]
        earlier = pose.rotation[:, joint - 1] if joint else np.broadcast_to(np.eye(3), turn.shape)
        column = joint if y.shape[1] > 1 else 0
        from_ = earlier @ [-0.015, y[cable, column], z[cable, column]]
        to = turn @ [0.015, v[cable, column], w[cable, column]]
        np.testing.assert_allclose(
            span[:, cable, joint], np.linalg.norm(to - from_, axis=-1), atol=1e-12
        )


def test_a_cables_tolerance_is_its_own_tension_angle_and_zero() -> None:
    place = "cable_7"
    tolerance = entry("cable_tolerance", place, pretension_n=0.5, angle_rad=0.004, zero_n=0.2)
    own = np.arange(12) == 6
    mechanism = amended(MECHANISM, [tolerance])
    np.testing.assert_allclose(mechanism.pretension_n - 50.0, 0.5 * own)
    np.testing.assert_allclose(
        np.hypot(mechanism.hole_y_m - MECHANISM.hole_y_m, mechanism.hole_z_m - MECHANISM.hole_z_m),
        2 * 0.05 * np.sin(0.002) * own,
        atol=1e-15,
    )
    replay = course(POSES, PUSH)
    zero = entry("cable_tolerance", place, zero_n=0.2)
    np.testing.assert_allclose(
        readings(replay, zero) - readings(replay), np.broadcast_to(0.2 * own, (5, 12)), atol=1e-9
    )


def test_a_segments_tolerance_is_its_mass_and_contact_point() -> None:
    mechanism = amended(
        MECHANISM, [entry("segment_tolerance", "segment_2", mass_share=0.02, contact_m=0.001)]
    )
    np.testing.assert_allclose(mechanism.mass_kg, [0.5, 0.51, 0.5, 0.5])
    np.testing.assert_allclose(mechanism.contact_m, [0.065, 0.066, 0.065, 0.065])


def test_the_actuators_hold_the_lengths_of_the_arm_as_it_was_drawn() -> None:
    """A turned hole circle shows at bent poses, where a controller that knew would not."""
    turned = entry("routing_geometry", "segment_3", cables_angle_rad=0.1)
    mechanism = amended(MECHANISM, [turned])
    told = solve_equilibrium(mechanism, POSES, PUSH).tensions_n
    replay = course(POSES, PUSH)
    held = readings(replay, turned)
    np.testing.assert_allclose(held[0], told[0], atol=1e-6)  # straight is straight
    assert np.abs(held[1:] - told[1:]).max() > 1.0
    assert ARM.segment_count == 4
