"""An admittance controller: the arm gives way to a push as a damped mass does.

    python -m examples.admittance  # while `cablesense demo` runs, in its ROS_DOMAIN_ID

The law is M dv/dt + D v = Jᵀf, with v the speeds of the joints, f the estimated force and J the
Jacobian of its place; the estimator publishes Jᵀf as `joint_torques`. docs/controller.md has more.
"""

from __future__ import annotations

import math
import sys
from collections import deque

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from sensor_msgs.msg import JointState

from cablesense_base import Array
from examples.read_topics import spin

INERTIA_KG_M2 = 20.0  # M, of every joint axis
DAMPING_N_M_S = 200.0  # D, of every joint axis; M / D is the time constant of the filter
FASTEST_RAD_S = math.radians(2.0)  # the estimator knows no force above its `follow_deg_s`, 4
SLOWEST_RAD_S = math.radians(0.01)  # slower is rest
LIMIT_RAD = math.radians(8.0)
PERIOD_S = 0.02
STALE_AFTER_S = 0.2
VOUCHED_FOR = ("free", "contact", "moment")  # the torques are true in no other state


def next_speeds_rad_s(speeds_rad_s: Array, torques_n_m: Array, period_s: float) -> Array:
    """The joint speeds (2N,) after a period of constant contact torques (2N,)."""
    # the law's solution: v(t) = Jᵀf/D + (v(0) - Jᵀf/D) exp(-t D/M)
    steady_rad_s = torques_n_m / DAMPING_N_M_S
    share_left = math.exp(-period_s * DAMPING_N_M_S / INERTIA_KG_M2)
    next_rad_s = steady_rad_s + share_left * (speeds_rad_s - steady_rad_s)
    # where one joint is too fast all are slowed alike: the direction stays
    fastest_rad_s = float(np.abs(next_rad_s).max())
    return next_rad_s * min(1.0, FASTEST_RAD_S / max(fastest_rad_s, FASTEST_RAD_S))


class Admittance(Node):
    """Turns the joints while the force is vouched for; in doubt the arm holds its last command."""

    def __init__(self) -> None:
        super().__init__("admittance")
        self._command_rad: dict[str, float] = {}  # by joint
        self._speeds_rad_s: Array = np.zeros(1)  # one for all joints
        self._torques: deque[JointState] = deque(maxlen=64)
        self._statuses: deque[DiagnosticArray] = deque(maxlen=64)
        self._doubt = "no estimate yet"
        self._out = self.create_publisher(JointState, "joint_commands", 10)
        listen = self.create_subscription  # rclpy takes no built-in function, such as append
        sensor = qos_profile_sensor_data
        listen(JointState, "joint_states", self._on_states, sensor)
        listen(JointState, "joint_commands", self._on_command, 10)
        listen(JointState, "estimator/joint_torques", lambda m: self._torques.append(m), sensor)
        listen(DiagnosticArray, "estimator/status", lambda m: self._statuses.append(m), sensor)
        self.create_timer(PERIOD_S, self._step)

    def _on_states(self, message: JointState) -> None:  # it begins where the arm is
        where_rad = dict(zip(message.name, message.position, strict=False))
        self._command_rad = where_rad | self._command_rad

    def _on_command(self, message: JointState) -> None:  # at rest another node may command
        if self._rests():
            self._command_rad |= dict(zip(message.name, message.position, strict=False))

    def _answerable(self) -> tuple[JointState, str]:
        """Torques of the newest sample of which the state is known, too, and why not to answer."""
        states = {_stamp_ns(each): each.status[0].message for each in self._statuses}
        with_state = [each for each in self._torques if _stamp_ns(each) in states]
        newest = with_state[-1] if with_state else JointState()
        age_s = 1e-9 * (self.get_clock().now().nanoseconds - _stamp_ns(newest))
        if not with_state or abs(age_s) > STALE_AFTER_S:
            return newest, "no fresh estimate"
        if not self._command_rad.keys() >= set(newest.name):
            return newest, "no joint_states yet"
        state = states[_stamp_ns(newest)]
        return newest, "" if state in VOUCHED_FOR else state

    def _step(self) -> None:
        torques, doubt = self._answerable()
        if doubt != self._doubt:
            self.get_logger().info(f"holds: {doubt}" if doubt else "yields to contacts")
        self._doubt = doubt
        if doubt:
            self._speeds_rad_s = np.zeros(1)
            return
        effort_n_m = np.array(torques.effort)
        self._speeds_rad_s = next_speeds_rad_s(self._speeds_rad_s, effort_n_m, PERIOD_S)
        if self._rests():
            return
        present_rad = np.array([self._command_rad[name] for name in torques.name])
        limit_rad = np.maximum(np.abs(present_rad), LIMIT_RAD)  # from beyond it only back
        next_rad = np.clip(present_rad + PERIOD_S * self._speeds_rad_s, -limit_rad, limit_rad)
        command = JointState(name=torques.name, position=next_rad.tolist())
        command.header.stamp = self.get_clock().now().to_msg()
        self._command_rad |= dict(zip(command.name, command.position, strict=True))
        self._out.publish(command)

    def _rests(self) -> bool:
        return bool(np.abs(self._speeds_rad_s).max() < SLOWEST_RAD_S)


def _stamp_ns(message: JointState | DiagnosticArray) -> int:
    return Time.from_msg(message.header.stamp).nanoseconds


if __name__ == "__main__":
    sys.exit(spin(Admittance))
