"""Joint commands by name and within reach; values find their place by name, or are refused.

A contact has a force and its moment; a load is a finite force at the contact point of a segment.
"""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_msgs_py.messages import (
    BREATH_END,
    Contact,
    NamedOrder,
    breath_frame,
    breath_turn,
    cable_offsets_m,
    joint_command_rad,
    read_load,
)
from cablesense_msgs_py.topics import ContractError, Frames

pytestmark = pytest.mark.filterwarnings(
    "ignore:module .sre_:DeprecationWarning"
)  # lark, of rosidl

ORDER = NamedOrder(("joint_1_pitch", "joint_1_yaw"), "joints")


def message(names, position):
    return SimpleNamespace(name=names, position=position)


def test_joints_of_others_are_passed_over_and_those_not_named_stay():
    present = np.array([0.3, 0.4])
    both = message(["joint_1_yaw", "joint_1_pitch"], [0.2, 0.1])
    np.testing.assert_array_equal(joint_command_rad(both, ORDER, present), [0.1, 0.2])
    some = message(["gripper", "joint_1_yaw", "rail"], [9.0, 0.1, math.nan])
    np.testing.assert_array_equal(joint_command_rad(some, ORDER, present), [0.3, 0.1])
    np.testing.assert_array_equal(joint_command_rad(some, ORDER), [0.0, 0.1])
    np.testing.assert_array_equal(present, [0.3, 0.4])


@pytest.mark.parametrize(
    ("names", "complaint"),
    [
        (["gripper", "rail"], "missing 'joint_1_pitch'"),
        (["joint_1_yaw", "joint_1_yaw"], "more than once 'joint_1_yaw'"),
        (["joint_1_yaw"], "2 values for 1 names"),
        ([], "2 values for 0 names"),
    ],
)
def test_a_command_of_no_joint_of_the_arm_or_of_one_twice_is_refused(names, complaint):
    with pytest.raises(ContractError, match=complaint):
        joint_command_rad(message(names, [0.0, 0.0]), ORDER)


@pytest.mark.parametrize("angle", [math.nan, math.inf, 1.1, -30.0])
def test_angles_out_of_reach_are_refused_by_name(angle):
    with pytest.raises(ContractError, match="joint_1_yaw"):
        joint_command_rad(message(["joint_1_pitch", "joint_1_yaw"], [0.0, angle]), ORDER)


@pytest.mark.parametrize("length", [math.nan, -math.inf, 0.1])
def test_offsets_that_no_cable_takes_are_refused_by_name(length):
    cables = NamedOrder(("cable_1", "cable_2"), "cables")
    assert list(cable_offsets_m(message(["cable_2", "cable_1"], [0.0, 1e-4]), cables)) == [1e-4, 0]
    with pytest.raises(ContractError, match=r"cable_2.* m; .*within"):
        cable_offsets_m(message(["cable_1", "cable_2"], [0.0, length]), cables)
    with pytest.raises(ContractError, match="unknown 'cable_3'"):
        cable_offsets_m(message(["cable_1", "cable_3"], [0.0, 0.0]), cables)


def framed(frame_id):
    return SimpleNamespace(header=SimpleNamespace(frame_id=frame_id))


@given(turn=st.integers(BREATH_END, 10**9 - 1))
def test_a_message_states_the_turn_of_its_breath(turn):
    assert breath_turn(framed(breath_frame(turn))) == turn
    assert breath_turn(framed("base_link")) is None


@pytest.mark.parametrize("frame", ["breath", "breath -1", "breath 1.5", "breath 1 2", "breathing"])
def test_what_is_no_turn_of_a_breath_is_refused(frame):
    with pytest.raises(ContractError, match="breath end"):
        breath_turn(framed(frame))


NAMES = tuple(f"cable_{i + 1}" for i in range(12))


@given(st.permutations(range(12)))
def test_any_order_gives_the_arms_order(order):
    arranged = NamedOrder(NAMES, "cables").arrange([NAMES[i] for i in order], order, "effort")
    np.testing.assert_array_equal(arranged, np.arange(12.0))


@pytest.mark.parametrize(
    ("names", "complaint"),
    [
        (NAMES[:-1], "missing 'cable_12'"),
        ((*NAMES, "cable_13"), "unknown 'cable_13'"),
        ((*NAMES[:-1], "cable_1"), "missing 'cable_12'; more than once 'cable_1'"),
        ((), "and 6 more"),
    ],
)
def test_wrong_names_are_listed(names, complaint):
    with pytest.raises(ContractError, match=complaint):
        NamedOrder(NAMES, "cables").pick(names, [0.0] * len(names), "effort")


FRAMES = Frames(4)


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 90.0, 200.0, 359.0])
def test_force_and_moment_are_those_of_a_push_at_the_contact_point(angle_deg):
    contact = Contact(2, angle_deg, 40.0, 0.065)
    assert np.linalg.norm(contact.wrench[:3]) == pytest.approx(40.0)
    y, z = contact.wrench[1:3]
    assert np.degrees(np.arctan2(y, z)) % 360 == pytest.approx(angle_deg)
    assert Contact.of_force(2, contact.wrench[:3], 0.065)[:5] == pytest.approx(contact[:5])
    np.testing.assert_allclose(
        contact.wrench[3:], np.cross([0.065, 0.0, 0.0], contact.wrench[:3]), atol=1e-12
    )


def message_wrenches(force=(0.0, 0.0, 0.0), torque=(0.0, 0.0, 0.0), frame="segment_2"):
    vector = lambda v: SimpleNamespace(x=v[0], y=v[1], z=v[2])  # noqa: E731
    return SimpleNamespace(
        header=SimpleNamespace(frame_id=frame),
        wrench=SimpleNamespace(force=vector(force), torque=vector(torque)),
    )


def test_a_wrench_in_the_base_frame_acts_where_its_line_meets_the_arm():
    force = np.array([3.0, 20.0, -35.0])
    torque = np.array([0.0, 1.0, 2.0])
    asked = []
    wrench = message_wrenches(force, torque, "base_link")
    load = read_load(wrench, FRAMES, lambda *given: (asked.append(given), (3, 0.08))[1])
    np.testing.assert_array_equal(asked, [(force, torque)])
    assert (load.segment, load.contact_m) == (3, 0.08)
    np.testing.assert_array_equal(load.force_base_n, force)


def test_a_force_in_a_segments_frame_acts_at_its_contact_point():
    load = read_load(message_wrenches((3.0, 20.0, -35.0), frame="segment_2"), FRAMES)
    assert (load.segment, load.contact_m) == (2, None)
    np.testing.assert_array_equal(load.force_base_n, [3.0, 20.0, -35.0])


def test_nothing_is_released_in_the_base_frame():
    with pytest.raises(ContractError, match="zero force in a segment's frame"):
        read_load(message_wrenches(frame="base_link"), FRAMES, lambda *_: (1, 0.0))


@pytest.mark.parametrize(
    ("wrong", "complaint"),
    [
        ({"force": (math.nan, 0.0, 0.0)}, "wrench.force"),
        ({"force": (math.inf, 0.0, 0.0)}, "wrench.force"),
        ({"force": (1e6, 0.0, 0.0)}, "at most 2000 N"),
        ({"torque": (0.0, 0.1, 0.0)}, "must be zero"),
        ({"torque": (0.0, math.nan, 0.0)}, "must be zero"),
        ({"frame": "segment_9"}, "segment_1, segment_2, segment_3, segment_4"),
    ],
)
def test_refuses_what_is_no_load(wrong, complaint):
    with pytest.raises(ContractError, match=complaint):
        read_load(message_wrenches(**wrong), FRAMES)
