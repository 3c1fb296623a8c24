"""An elastic wall that presses on one segment of the simulated arm, and never pulls."""

from __future__ import annotations

import time

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState

from cablesense_base import Array
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import NamedOrder
from cablesense_msgs_py.qos import COMMAND, PUBLISHER
from cablesense_msgs_py.topics import Frames
from cablesense_ros.endpoints import RefusalLog, qos_profile
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium, stiffness_matrix_n_m
from cablesense_sim.loads import normal_force_n
from cablesense_sim.mechanism import Mechanism

LONGEST_PAUSE_S = 0.1  # a longer pause between two joint_states does not move the wall


class ElasticWall:
    """A half space that pushes along its normal with F = k p at penetration p.

    An arm of compliance c has already deflected under the last force when its pose is read. To
    press with k p at once would overshoot by the factor k c, and shake the arm from k c = 1 on.
    Each update therefore takes a Newton step on F = k (p + c (F_last − F)), which is exact for an
    arm at rest.

    Attributes:
        point_m: (3,) a point of the surface at advance 0, base frame.
        normal: (3,) unit vector out of the wall, towards the arm.
        compliance_m_n: of the arm at the contact point, along the normal.
        force_n: of the last update.
    """

    def __init__(
        self, point_m: Array, normal: Array, stiffness_n_m: float, compliance_m_n: float
    ) -> None:
        self.point_m = point_m
        self.normal = normal
        self.compliance_m_n = compliance_m_n
        self._stiffness_n_m = stiffness_n_m
        self.force_n = 0.0

    def update(self, contact_point_m: Array, advance_m: float) -> Array:
        """The force (3,), N, on a contact point (3,), the wall `advance_m` along its normal."""
        penetration_m = advance_m - float(self.normal @ (contact_point_m - self.point_m))
        if penetration_m > 0.0 or self.force_n > 0.0:
            missing_n = self._stiffness_n_m * penetration_m - self.force_n
            missing_n /= 1.0 + self._stiffness_n_m * self.compliance_m_n
            self.force_n = max(0.0, self.force_n + missing_n)
        return self.force_n * self.normal


def wall_beside(
    mechanism: Mechanism, command_rad: Array, segment: int, angle_deg: float, stiffness_n_m: float
) -> ElasticWall:
    """A wall that just touches the contact point of a segment of the arm at rest.

    It pushes normal to the segment, at `angle_deg` from the segment's +z towards its +y.

    Raises:
        LoadError: no such segment.
        EquilibriumError: the arm has no rest at this command (2N,).
    """
    angles_rad = solve_equilibrium(mechanism, command_rad).joint_angles_rad
    normal = normal_force_n(mechanism, angles_rad, segment, angle_deg, 1.0)[segment - 1]
    point_m = np.asarray(kinematics.contact_points_m(mechanism, angles_rad)[segment - 1])
    compliance = compliance_m_n(mechanism, command_rad, segment, normal)
    return ElasticWall(point_m, normal, stiffness_n_m, compliance)


def compliance_m_n(
    mechanism: Mechanism, command_rad: Array, segment: int, direction: Array
) -> float:
    """How far a segment's contact point deflects along a unit vector (3,), unloaded, m/N."""
    rest = solve_equilibrium(mechanism, command_rad)
    unloaded = np.zeros((mechanism.segment_count, 3))
    stiffness = stiffness_matrix_n_m(mechanism, rest.joint_angles_rad, rest.tensions_n, unloaded)
    jacobians = kinematics.contact_jacobians_m(mechanism, rest.joint_angles_rad)
    lever_m = jacobians[segment - 1].T @ direction
    return float(lever_m @ np.linalg.solve(stiffness, lever_m))


class Obstacle:
    """Answers every `joint_states` of the simulated, straight arm with the load of a wall.

    Attributes:
        wall: beside the arm.
        target_m: where the wall moves to, along its normal; 0 touches the undeflected arm.
        advance_m: where it is.
    """

    def __init__(
        self,
        node: Node,
        arm: Arm,
        segment: int,
        stiffness_n_m: float,
        start_m: float,
        speed_m_s: float = 0.05,
    ) -> None:
        """The wall begins at `start_m` and presses to the left, +y."""
        self._node = node
        self._segment = segment
        self._speed_m_s = speed_m_s
        self._mechanism = mechanism_of(arm)
        straight = np.zeros(arm.joint_count)
        self.wall = wall_beside(self._mechanism, straight, segment, 90.0, stiffness_n_m)
        self.target_m = start_m
        self.advance_m = self.target_m
        self._updated_s = time.monotonic()
        self._joints = NamedOrder(arm.joint_names, "joints")
        self._load = WrenchStamped()
        self._load.header.frame_id = Frames(arm.segment_count).segment(segment)
        self._loads_out = node.create_publisher(
            WrenchStamped, topics.APPLIED_WRENCH, qos_profile(PUBLISHER)
        )
        refuse = RefusalLog(node)
        refuse.subscribe(JointState, topics.JOINT_STATES, COMMAND, self._on_joint_states)

    def _on_joint_states(self, message: JointState) -> None:
        now_s = time.monotonic()
        reach_m = self._speed_m_s * min(now_s - self._updated_s, LONGEST_PAUSE_S)
        self._updated_s = now_s
        self.advance_m += float(np.clip(self.target_m - self.advance_m, -reach_m, reach_m))
        angles_rad = self._joints.arrange(message.name, message.position, "position")
        points_m = kinematics.contact_points_m(self._mechanism, angles_rad)
        force_n = self.wall.update(points_m[self._segment - 1], self.advance_m)
        self._load.header.stamp = self._node.get_clock().now().to_msg()
        force = self._load.wrench.force
        force.x, force.y, force.z = force_n.tolist()
        self._loads_out.publish(self._load)
