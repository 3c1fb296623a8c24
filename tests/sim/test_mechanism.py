"""The arrays of an arm, and contact forces on it."""

import math

import numpy as np
import pytest
from arm_variants import variant
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import LoadError, contact_angle_deg, normal_force_n
from cablesense_sim.mechanism import Mechanism


@pytest.fixture(scope="module")
def mechanism() -> Mechanism:
    return mechanism_of(open_arm("cdsm"))


def test_a_cable_passes_every_joint_up_to_its_segment(mechanism: Mechanism) -> None:
    assert mechanism.passes_joint[4].tolist() == [True, True, False, False]
    assert mechanism.passes_joint.sum() == 3 * (1 + 2 + 3 + 4)


def test_the_holes_lie_at_the_angles_of_the_file(mechanism: Mechanism) -> None:
    angle = np.rad2deg(np.arctan2(mechanism.hole_y_m, mechanism.hole_z_m)) % 360
    expected = [(30 * n - 120 * k) % 360 for n in range(4) for k in range(3)]
    np.testing.assert_allclose(angle, expected, atol=1e-9)
    np.testing.assert_allclose(np.hypot(mechanism.hole_y_m, mechanism.hole_z_m), 0.05)


def test_plates_touch_where_the_drawing_says(mechanism: Mechanism) -> None:
    np.testing.assert_allclose(
        np.rad2deg(mechanism.bend_limit_rad), 2 * math.degrees(math.atan2(0.015, 0.05))
    )


def test_stiffness_of_cable_and_actuator_in_series(mechanism: Mechanism) -> None:
    compliance = 1 / mechanism.cable_stiffness_n_m + 1 / mechanism.actuator_stiffness_n_m
    np.testing.assert_allclose(1 / compliance, 1e7)


def test_axial_rigidity_makes_long_cables_softer() -> None:
    soft = mechanism_of(variant({"cables.stiffness_n_m": None, "cables.axial_rigidity_n": 2.3e5}))
    np.testing.assert_allclose(soft.cable_stiffness_n_m[0], 2.3e5 / 0.23)
    np.testing.assert_allclose(
        soft.cable_stiffness_n_m * soft.straight_length_m, 2.3e5, rtol=1e-12
    )
    np.testing.assert_allclose(
        1 / soft.stiffness_n_m, 1 / soft.cable_stiffness_n_m + 1 / 1e8, rtol=1e-12
    )


def test_values_of_single_segments_go_to_their_cables() -> None:
    tapered = mechanism_of(
        variant(
            {
                "segments.length_m": [0.2, 0.15, 0.1, 0.08],
                "segments.contact_m": [0.1, 0.07, 0.05, 0.04],
                "segments.mass_kg": [0.8, 0.6, 0.4, 0.2],
                "cables.routing_radius_m": [0.06, 0.05, 0.04, 0.03],
            }
        )
    )
    radius = np.hypot(tapered.hole_y_m, tapered.hole_z_m)
    np.testing.assert_allclose(radius, np.repeat([0.06, 0.05, 0.04, 0.03], 3))
    np.testing.assert_allclose(tapered.centre_of_mass_m, [0.1, 0.075, 0.05, 0.04])
    # the wide cables of segment 1 end there, so the last joint may bend furthest
    assert (np.diff(tapered.bend_limit_rad) > 0).all()


MECHANISM = mechanism_of(open_arm("cdsm"))
STRAIGHT = np.zeros(8)


@pytest.mark.parametrize(
    ("angle_deg", "direction"),
    [(0, [0, 0, 1]), (90, [0, 1, 0]), (180, [0, 0, -1]), (270, [0, -1, 0]), (-90, [0, -1, 0])],
)
def test_the_angle_counts_from_up_to_left(angle_deg: float, direction: list[float]) -> None:
    forces = normal_force_n(MECHANISM, STRAIGHT, 2, angle_deg, 10.0)
    expected = np.zeros((4, 3))
    expected[1] = 10.0 * np.array(direction)
    np.testing.assert_allclose(forces, expected, atol=1e-12)


angles = st.lists(st.floats(-0.5, 0.5), min_size=8, max_size=8)


@settings(max_examples=60, deadline=None)
@given(
    command=angles,
    segment=st.integers(1, 4),
    angle_deg=st.floats(-1000.0, 1000.0),
    magnitude_n=st.floats(1e-3, 1e4),
)
def test_there_and_back(
    command: list[float], segment: int, angle_deg: float, magnitude_n: float
) -> None:
    forces = normal_force_n(MECHANISM, command, segment, angle_deg, magnitude_n)
    force = forces[segment - 1]
    assert np.count_nonzero(forces.any(axis=-1)) == 1
    assert np.linalg.norm(force) == pytest.approx(magnitude_n)
    axis = kinematics.segment_rotations(MECHANISM, np.array(command))[segment - 1, :, 0]
    assert axis @ force == pytest.approx(0.0, abs=1e-9 * magnitude_n)
    back = float(contact_angle_deg(MECHANISM, command, segment, force))
    assert 0.0 <= back < 360.0
    assert abs((back - angle_deg + 180.0) % 360.0 - 180.0) < 1e-6


def test_batches_are_their_rows() -> None:
    rng = np.random.default_rng(3)
    command = rng.uniform(-0.3, 0.3, (5, 6, 8))
    segment = rng.integers(0, 5, (5, 6))
    angle = rng.uniform(0, 360, (5, 6))
    forces = normal_force_n(MECHANISM, command, segment, angle, 7.0)
    assert forces.shape == (5, 6, 4, 3)
    for i in np.ndindex(5, 6):
        alone = normal_force_n(MECHANISM, command[i], segment[i], angle[i], 7.0)
        np.testing.assert_array_equal(forces[i], alone)
    touched = segment > 0
    back = contact_angle_deg(
        MECHANISM, command[touched], segment[touched], forces[touched, segment[touched] - 1]
    )
    np.testing.assert_allclose(back, angle[touched], atol=1e-9)


@pytest.mark.parametrize(
    ("segment", "angle_deg", "magnitude_n", "words"),
    [
        (5, 0.0, 1.0, "from 0 .* to 4"),
        (-1, 0.0, 1.0, "from 0 .* to 4"),
        (1.5, 0.0, 1.0, "whole number"),
        (1, np.nan, 1.0, "angle_deg"),
        (1, np.inf, 1.0, "angle_deg"),
        (1, 0.0, -1.0, "magnitude_n"),
        (1, 0.0, np.nan, "magnitude_n"),
        ([1, 9], 0.0, 1.0, "from 0 .* to 4"),
    ],
)
def test_impossible_contacts_are_refused(
    segment: object, angle_deg: float, magnitude_n: float, words: str
) -> None:
    with pytest.raises(LoadError, match=words):
        normal_force_n(MECHANISM, STRAIGHT, segment, angle_deg, magnitude_n)
