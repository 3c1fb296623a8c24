"""Where a wrench about the base's origin acts on the arm: its line of action meets the axis."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import LoadError, contact_of_wrench
from cablesense_sim.touch import touched_places
from tests.helpers.effect_arms import bent

MECHANISM = mechanism_of(open_arm("cdsm"))
TOUCHED_M = touched_places(open_arm("cdsm")).touched_m


def point_m(pose, segment, place_m):
    chain = kinematics.chain(MECHANISM, pose)
    return chain.joint_m[segment - 1] + place_m * chain.rotation[segment - 1, :, 0]


def found(pose, force_n, at_m):
    return contact_of_wrench(MECHANISM, pose, TOUCHED_M, force_n, np.cross(at_m, force_n))


@given(
    seed=st.integers(0, 999),
    segment=st.integers(1, 4),
    share=st.floats(0.12, 0.95),  # where two segments meet, either is touched
    angle_rad=st.floats(0.0, 6.28),
    along_n=st.floats(-20.0, 20.0),
)
def test_the_place_of_a_push_anywhere_is_found_whatever_its_axial_part(
    seed, segment, share, angle_rad, along_n
):
    pose = bent(seed, most_deg=8.0)
    nearest_m, farthest_m = TOUCHED_M[segment - 1]
    place_m = nearest_m + share * (farthest_m - nearest_m)
    local_n = np.array([along_n, 40.0 * np.sin(angle_rad), 40.0 * np.cos(angle_rad)])
    force_n = kinematics.segment_rotations(MECHANISM, pose)[segment - 1] @ local_n
    at_m = point_m(pose, segment, place_m)
    assert found(pose, force_n, at_m) == (segment, pytest.approx(place_m, abs=1e-9))
    # the torque leaves open where on its line the force acts: on the surface, or on the axis
    assert found(pose, force_n, at_m - 0.05 * force_n / 40.0)[0] == segment


def test_a_line_beside_the_axis_acts_at_the_nearest_point_up_to_a_limit():
    pose = np.zeros(8)
    aside_m = np.array([0.0, 0.02, 0.0])
    at_m = point_m(pose, 3, 0.065)
    assert found(pose, np.array([0.0, 0.0, 30.0]), at_m + aside_m) == (3, pytest.approx(0.065))
    with pytest.raises(LoadError, match="40, 76 mm away"):
        found(pose, np.array([0.0, 0.0, 30.0]), at_m + 2.0 * aside_m)


@pytest.mark.parametrize(
    ("force_n", "torque_n_m"),
    [
        ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
        ([30.0, 0.0, 0.0], [0.0, 0.0, 0.0]),  # through all segments of the straight arm
        ([0.0, 20.0, 0.0], [0.0, 0.0, 20.0]),  # beyond the tip
        ([0.0, 20.0, 0.0], [0.0, 1.0, 4.0]),  # a torque about the force's own line
        ([0.0, 20.0, 0.0], [0.0, 0.0, np.nan]),
    ],
)
def test_a_wrench_that_acts_on_no_one_segment_is_refused(force_n, torque_n_m):
    with pytest.raises(LoadError):
        contact_of_wrench(
            MECHANISM, np.zeros(8), TOUCHED_M, np.array(force_n), np.array(torque_n_m)
        )
