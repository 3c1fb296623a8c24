"""The arm's numbers as arrays, against what the arm file says in words."""

import math

import numpy as np
import pytest
from arm_variants import variant

from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
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
