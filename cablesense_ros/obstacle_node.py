"""The `obstacle` node: an elastic wall that presses on a segment of the simulated arm."""

from __future__ import annotations

import sys
import time
from functools import partial

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState

from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import Level, NamedOrder, Status
from cablesense_msgs_py.qos import COMMAND, PUBLISHER
from cablesense_msgs_py.topics import Frames
from cablesense_online.admittance.wall import (
    Approach,
    WallPressing,
    compliance_m_n,
    wall_beside,
)
from cablesense_ros.endpoints import RefusalLog, overridable
from cablesense_ros.node_process import publish_diagnostics, run_node
from cablesense_ros.parameters import ParameterError, declare_parameters, parameter_table
from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of

LONGEST_PAUSE_S = 0.1
"""A pause longer than this between two `joint_states` does not move the wall on."""


class ObstacleNode(Node):
    """Answers every `joint_states` with the load that the wall puts on the arm."""

    def __init__(self) -> None:
        super().__init__("obstacle")
        self._given = declare_parameters(self, parameter_table("obstacle"))
        arm = open_arm(self._given["arm"])
        self._mechanism = mechanism_of(arm)
        self._segment = self._given["segment"]
        if self._segment > arm.segment_count:
            raise ParameterError(
                f"parameter segment is {self._segment}; this arm has 1 to {arm.segment_count}"
            )
        frames = Frames(arm.segment_count, self._given["frame_prefix"])
        self._load = WrenchStamped()
        self._load.header.frame_id = frames.segment(self._segment)
        self._joint_order = NamedOrder(arm.joint_names, "joints")
        self._pressing: WallPressing | None = None
        self._approach = Approach(-self._given["clearance_m"], self._given["speed_m_s"])
        self._since_s = self._latest_s = time.monotonic()
        self._loads_out = self.create_publisher(
            WrenchStamped, topics.APPLIED_WRENCH, **overridable(PUBLISHER)
        )
        RefusalLog(self).subscribe(JointState, topics.JOINT_STATES, COMMAND, self._on_joint_states)
        self.add_post_set_parameters_callback(self._on_parameters)
        publish_diagnostics(self, self._statuses, lambda: arm.identity)
        self.get_logger().info(
            f"arm {arm.identity}: a wall of {self._given['stiffness_n_m']:g} N/m beside segment "
            f"{self._segment}"
        )

    def destroy_node(self) -> None:
        """Let go of the arm."""
        self._press(np.zeros(3))
        # a publisher that is gone repeats nothing, and the arm would stay loaded
        self._loads_out.wait_for_all_acked(Duration(seconds=1))
        super().destroy_node()

    def _on_joint_states(self, message: JointState) -> None:
        now_s = time.monotonic()
        elapsed_s, self._latest_s = min(now_s - self._latest_s, LONGEST_PAUSE_S), now_s
        angles = self._joint_order.arrange(message.name, message.position, "position")
        if self._pressing is None:
            angle, stiffness, damping = (
                self._given[name] for name in ("angle_deg", "stiffness_n_m", "damping_n_s_m")
            )
            wall = wall_beside(self._mechanism, angles, self._segment, angle, stiffness, damping)
            compliance = compliance_m_n(self._mechanism, angles, self._segment, wall.normal)
            self._pressing = WallPressing(wall, compliance)
            self._since_s = now_s
        point = kinematics.contact_points_m(self._mechanism, angles)[self._segment - 1]
        advance_m = self._approach.advance_m
        if now_s - self._since_s >= self._given["delay_s"]:
            advance_m = self._approach.towards(self._given["depth_m"], elapsed_s)
        self._press(self._pressing.update(point, advance_m, elapsed_s))

    def _press(self, force_n: np.ndarray) -> None:
        self._load.header.stamp = self.get_clock().now().to_msg()
        force = self._load.wrench.force
        force.x, force.y, force.z = force_n.tolist()
        self._loads_out.publish(self._load)

    def _on_parameters(self, parameters: list[Parameter]) -> None:
        self._given |= {p.name: p.value for p in parameters}
        self._approach.speed_m_s = self._given["speed_m_s"]

    def _statuses(self) -> list[Status]:
        if self._pressing is None:
            return [Status("wall", Level.WARN, "no joint_states yet")]
        force_n = self._pressing.force_n
        message = f"presses on segment {self._segment}" if force_n else "does not touch"
        values = {
            "force (N)": f"{force_n:.2f}",
            "advance (mm)": f"{1e3 * self._approach.advance_m:.2f}",
            "stiffness (N/m)": f"{self._given['stiffness_n_m']:g}",
        }
        return [Status("wall", Level.OK, message, values)]


main = partial(run_node, ObstacleNode)


if __name__ == "__main__":
    sys.exit(main())
