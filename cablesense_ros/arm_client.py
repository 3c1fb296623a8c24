"""A client of a running arm: takes its messages, sends commands and loads, records moments."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from cablesense_base import Array
from cablesense_msgs_py import qos, topics
from cablesense_msgs_py.messages import put_joint_angles
from cablesense_online.page.live_arm import LiveArm
from cablesense_online.samples import FollowedPublisher
from cablesense_ros.endpoints import RefusalLog, of_node, overridable
from cablesense_sim.arm import Arm
from cablesense_sim.equilibrium import checked_command

Moment = TypeVar("Moment")

RECORD_EVERY_S = 0.04
LISTENERS = 3
"""Readers of a command once all are up: the arm, the estimator and the client itself."""


class ArmClient:
    """Feeds a `LiveArm` with every message, and publishes what a person or a script asks for."""

    def __init__(self, node: Node, arm: Arm, live: LiveArm, estimator: str) -> None:
        """Subscribe `node`; messages that break the contract are logged."""
        self._node = node
        self._live = live
        self._joint_names = list(arm.joint_names)
        inputs: tuple[tuple[type, str, qos.Qos, Callable[[Any], None]], ...] = (
            (JointState, topics.CABLE_TENSIONS, qos.SENSOR, _timed(live.on_tensions)),
            (JointState, topics.JOINT_STATES, qos.SENSOR, live.on_joint_states),
            (JointState, topics.JOINT_COMMANDS, qos.COMMAND, live.on_joint_commands),
            (WrenchStamped, topics.APPLIED_WRENCH, qos.COMMAND, live.on_load),
            (WrenchStamped, topics.WRENCH, qos.SENSOR, _timed(live.on_wrench)),
            (DiagnosticArray, topics.STATUS, qos.SENSOR, _timed(live.on_status)),
            (WrenchStamped, topics.WRENCH_LOWER, qos.SENSOR, _timed(live.on_lower)),
            (WrenchStamped, topics.WRENCH_UPPER, qos.SENSOR, _timed(live.on_upper)),
            (Float64MultiArray, topics.CONTACT_PROBABILITIES, qos.SENSOR, live.on_probabilities),
            (DiagnosticArray, topics.DIAGNOSTICS, qos.COMMAND, _timed(live.on_diagnostics)),
        )
        of_segments = tuple(
            (
                WrenchStamped,
                topics.SEGMENT_WRENCHES.format(number),
                qos.SENSOR,
                _timed(live.on_segment_wrench),
            )
            for number in range(1, arm.segment_count + 1)
        )
        refuse = RefusalLog(node)
        for kind, topic, quality, handle in (*inputs, *of_segments):
            publisher = live.tension_publisher if topic == topics.CABLE_TENSIONS else None
            if publisher is None and quality is qos.SENSOR:
                publisher = FollowedPublisher()
            refuse.subscribe(kind, of_node(estimator, topic), quality, handle, publisher)
        self._loads, self._commands = (
            node.create_publisher(kind, topic, **overridable(qos.COMMAND))
            for kind, topic in (
                (WrenchStamped, topics.APPLIED_WRENCH),
                (JointState, topics.JOINT_COMMANDS),
            )
        )

    @property
    def connected(self) -> bool:
        """Whether arm and estimator read commands."""
        return self._commands.get_subscription_count() >= LISTENERS

    def command(self, joint_angles_rad: Array) -> None:
        """Send joint angles (2N,).

        Raises:
            EquilibriumError: not finite, or a bend at which guide plates would touch.
        """
        command = checked_command(self._live.mechanism, joint_angles_rad)
        message = JointState(name=self._joint_names)
        message.header.stamp = self._node.get_clock().now().to_msg()
        put_joint_angles(message, command)
        self._commands.publish(message)

    def push(
        self, segment: int, angle_deg: float, magnitude_n: float, beside: bool = False
    ) -> None:
        """Put one load on the arm, in place of others or `beside` them; 0 N or segment 0 releases.

        Raises:
            LoadError: no such segment, or numbers that are not finite.
        """
        for load in self._live.loads_of(segment, angle_deg, magnitude_n, beside=beside):
            message = WrenchStamped()
            message.header.stamp = self._node.get_clock().now().to_msg()
            message.header.frame_id = self._live.frames.segment(load.segment)
            force = message.wrench.force
            force.x, force.y, force.z = (float(component) for component in load.force_base_n)
            self._loads.publish(message)


def _timed(handle: Callable[[Any, float], None]) -> Callable[[Any], None]:
    return lambda message: handle(message, time.monotonic())


def record(
    moment: Callable[[float], Moment], duration_s: float, check: Callable[[], object]
) -> tuple[Array, list[Moment]]:
    """Act and observe every `RECORD_EVERY_S`.

    Args:
        moment: takes the time since the start, s; does what is due and gives what is seen.
        duration_s: of the whole.
        check: called at every step; raises to end it.

    Returns:
        Times (K,) since the start, s, and the K moments.
    """
    start_s = time.monotonic()
    times, moments = [], []
    while (now_s := time.monotonic() - start_s) < duration_s:
        check()
        moments.append(moment(now_s))
        times.append(now_s)
        time.sleep(RECORD_EVERY_S)
    return np.array(times), moments
