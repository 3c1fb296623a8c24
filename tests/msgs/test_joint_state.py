"""Joint commands by name, within reach."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

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
