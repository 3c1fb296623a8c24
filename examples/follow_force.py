"""A controller that follows a push: the arm turns in the direction in which it is pushed.

    python -m examples.follow_force         # with `cablesense demo`, in the same ROS_DOMAIN_ID

Each contact above a threshold turns the joints by a fixed gain times the joint torques of the
contact. The estimator gives no force while the arm moves fast, so the steps are small and slow.
`examples/admittance` has a controller with a stability proof and stops; this one has neither.
"""

from __future__ import annotations

import sys
import time
from functools import partial

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState

from cablesense_base import Array
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import NamedOrder, put_joint_angles
from cablesense_msgs_py.qos import PUBLISHER, SENSOR
from cablesense_ros.endpoints import RefusalLog, of_node, qos_profile
from cablesense_ros.node_process import run_node
from cablesense_sim.arm import open_arm

GAIN_RAD_PER_N_M = 0.002
THRESHOLD_N_M = 0.2  # smaller torques are noise
LIMIT_RAD = float(np.deg2rad(8.0))
EVERY_S = 1.0  # longer than a step and the time that the arm needs to settle


def next_command_rad(command_rad: Array, torques_n_m: Array) -> Array:
    """The next joint angles (2N,) for the external joint torques (2N,)."""
    firm = np.where(np.abs(torques_n_m) > THRESHOLD_N_M, torques_n_m, 0.0)
    return np.clip(command_rad + GAIN_RAD_PER_N_M * firm, -LIMIT_RAD, LIMIT_RAD)


class FollowForce(Node):
    """Reads `~/joint_torques`, publishes `joint_commands`."""

    def __init__(self) -> None:
        super().__init__("follow_force")
        arm = open_arm("cdsm")
        self._joints = NamedOrder(arm.joint_names, "joints")
        self._command_rad, self._stepped_s = np.zeros(arm.joint_count), time.monotonic()
        self._message = JointState(name=list(arm.joint_names))
        self._out = self.create_publisher(
            JointState, topics.JOINT_COMMANDS, qos_profile(PUBLISHER)
        )
        topic = of_node("estimator", topics.JOINT_TORQUES)
        RefusalLog(self).subscribe(JointState, topic, SENSOR, self._on_torques)

    def _on_torques(self, message: JointState) -> None:
        torques_n_m = self._joints.arrange(message.name, message.effort, "effort")
        if not np.isfinite(torques_n_m).all() or time.monotonic() - self._stepped_s < EVERY_S:
            return
        command_rad = next_command_rad(self._command_rad, torques_n_m)
        if not np.array_equal(command_rad, self._command_rad):
            self._command_rad, self._stepped_s = command_rad, time.monotonic()
            put_joint_angles(self._message, command_rad)
            self._message.header.stamp = self.get_clock().now().to_msg()
            self._out.publish(self._message)


main = partial(run_node, FollowForce)


if __name__ == "__main__":
    sys.exit(main())
