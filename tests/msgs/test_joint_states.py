"""Joint commands by name and within reach; values find their place by name, or are refused."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_msgs_py.joint_states import (
    NamedOrder,
    joint_command_rad,
    put_joint_angles,
    put_tensions,
)
from cablesense_msgs_py.topics import ContractError

pytestmark = pytest.mark.filterwarnings(
    "ignore:module .sre_:DeprecationWarning"
)  # lark, of rosidl

ORDER = NamedOrder(("joint_1_pitch", "joint_1_yaw"), "joints")


def message(names, position):
    return SimpleNamespace(name=names, position=position)


def test_order_is_by_name():
    command = joint_command_rad(message(["joint_1_yaw", "joint_1_pitch"], [0.2, 0.1]), ORDER)
    np.testing.assert_array_equal(command, [0.1, 0.2])


@pytest.mark.parametrize("angle", [math.nan, math.inf, 1.1, -30.0])
def test_angles_out_of_reach_are_refused_by_name(angle):
    with pytest.raises(ContractError, match="joint_1_yaw"):
        joint_command_rad(message(["joint_1_pitch", "joint_1_yaw"], [0.0, angle]), ORDER)


def test_messages_carry_tensions_as_efforts_and_angles_as_positions():
    sensor_msgs = pytest.importorskip("sensor_msgs.msg")
    state = sensor_msgs.JointState()
    put_tensions(state, np.array([1.0, 2.5]))
    put_joint_angles(state, np.array([0.5]))
    assert list(state.effort) == [1.0, 2.5]
    assert list(state.position) == [0.5]


NAMES = tuple(f"cable_{i + 1}" for i in range(12))


@given(st.permutations(range(12)))
def test_any_order_gives_the_arms_order(order):
    arranged = NamedOrder(NAMES, "cables").arrange([NAMES[i] for i in order], order, "effort")
    np.testing.assert_array_equal(arranged, np.arange(12.0))


def test_a_good_message_is_taken_after_a_refused_one():
    order = NamedOrder(NAMES, "cables")
    with pytest.raises(ContractError):
        order.pick(["x"], [1.0], "effort")
    assert order.pick(NAMES, range(12), "effort") == tuple(range(12))


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


@pytest.mark.parametrize("count", [0, 11, 13])
def test_one_value_per_name(count):
    with pytest.raises(ContractError, match=f"effort holds {count} values for 12 names"):
        NamedOrder(NAMES, "cables").pick(NAMES, [0.0] * count, "effort")
