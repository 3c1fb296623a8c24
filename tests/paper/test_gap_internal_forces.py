"""Changes split into what carries moments and what only other cables feel."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.simulator import Term
from cablesense_paper.tension_changes import TensionChanges, internal_n, moments_n_m
from cablesense_sim.arm import open_arm

ARM = open_arm("cdsm_table2")
SEGMENT = np.array([1, 2, 3])
LOAD = np.array([[0.0, 5.0, -10.0]] * 3)
COURSE = TensionChanges("hung", SEGMENT, LOAD, np.zeros((3, 9))).course(6)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-30.0, 30.0), min_size=9, max_size=9))
def test_the_internal_part_carries_nothing_and_the_rest_has_none(changes):
    change = np.array([changes])
    inner = internal_n(ARM, change)
    np.testing.assert_allclose(moments_n_m(ARM, inner), 0.0, atol=1e-9)
    np.testing.assert_allclose(internal_n(ARM, change - inner), 0.0, atol=1e-9)
    assert (inner * (change - inner)).sum() == pytest.approx(0.0, abs=1e-6)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-10.0, 10.0), min_size=3, max_size=3))
def test_cables_of_a_segment_that_tighten_alike_are_internal(by_segment):
    change = np.repeat([by_segment], 3, axis=1)
    np.testing.assert_allclose(internal_n(ARM, change), change, atol=1e-9)


def test_moments_are_those_of_the_load_about_each_joint():
    tensions = ArmSimulator(ARM, COURSE).predict([{}])[0]
    moments = moments_n_m(ARM, tensions[1::2] - tensions[::2])
    length, contact = ARM.segments.length_m, ARM.segments.contact_m
    joint = np.arange(3)
    lever = np.maximum((SEGMENT[:, None] - 1 - joint) * length + contact, 0.0)
    np.testing.assert_allclose(np.abs(moments[:, ::2]), 10.0 * lever, rtol=2e-3, atol=1e-3)
    np.testing.assert_allclose(np.abs(moments[:, 1::2]), 5.0 * lever, rtol=2e-3, atol=1e-3)


@pytest.mark.parametrize("effect", [("cable_stiffness", "change", 0.7),
                                    ("contact_offset", "offset_m", 0.02)])  # fmt: skip
@pytest.mark.parametrize("place", ["segment_1", "segment_2", "segment_3"])
def test_neither_springs_nor_contact_points_make_internal_forces(effect, place):
    name, parameter, value = effect
    tensions = ArmSimulator(ARM, COURSE).predict([{Term(name, place, parameter): value}])[0]
    assert np.abs(internal_n(ARM, tensions[1::2] - tensions[::2])).max() < 0.02
