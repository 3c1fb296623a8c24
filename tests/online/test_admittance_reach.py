"""Joint angles within reach: nearest, convex, short of the guide plates."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cablesense_online.admittance.law import Reach
from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of

ARM = mechanism_of(open_arm("cdsm"))
angles = st.lists(st.floats(-1.5, 1.5), min_size=8, max_size=8).map(np.array)


@given(angles)
def test_no_joint_bends_farther_than_its_limit(command):
    reach = Reach.of(ARM, np.deg2rad(90.0))
    nearest = reach.nearest(command)
    assert reach.holds(nearest)
    assert (kinematics.bend_rad(nearest) < ARM.bend_limit_rad).all()
    assert np.all(reach.radius_rad < ARM.bend_limit_rad)


@given(angles, angles)
def test_it_is_the_nearest_point(command, other):
    reach = Reach.of(ARM, 0.2)
    nearest, inside = reach.nearest(command), reach.nearest(other)
    assert (command - nearest) @ (inside - nearest) <= 1e-9


@given(angles)
def test_what_is_within_reach_stays(command):
    reach = Reach.of(ARM, 0.2)
    inside = reach.nearest(command) * 0.99
    assert np.array_equal(reach.nearest(inside), inside)
