"""A client of a running machine: takes its messages, sends commands and loads."""

from __future__ import annotations

import time
from collections.abc import Collection
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped, WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from cablesense_base import Array
from cablesense_msgs_py import qos, topics
from cablesense_msgs_py.messages import Contact, put_joint_angles
from cablesense_online.followed_publisher import FollowedPublisher
from cablesense_online.page.live_machine import LiveMachine
from cablesense_online.page.shown import ShownMachine
from cablesense_ros.endpoints import RefusalLog, of_node, qos_profile


class MachineClient:
    """Feeds a `LiveMachine` with messages, and publishes what a person or a script asks for."""

    def __init__(
        self,
        node: Node,
        live: LiveMachine,
        estimator: str,
        readers: Collection[str] = ("sim", "estimator"),
    ) -> None:
        """Subscribe `node`; messages that break the contract are logged.

        `readers` are the names of the nodes that read commands once all are up.
        """
        self._node = node
        self._readers = frozenset(readers)
        self._live = live
        self._command_names = list(live.shown.felt.command_names)
        inputs: tuple[tuple[type, str, qos.Qos], ...] = (
            (JointState, topics.CABLE_TENSIONS, qos.SENSOR_QOS),
            (JointState, topics.JOINT_STATES, qos.SENSOR_QOS),
            (JointState, topics.JOINT_COMMANDS, qos.COMMAND_QOS),
            (WrenchStamped, topics.APPLIED_WRENCH, qos.COMMAND_QOS),
            (WrenchStamped, topics.WRENCH, qos.SENSOR_QOS),
            (DiagnosticArray, topics.STATUS, qos.SENSOR_QOS),
            (WrenchStamped, topics.WRENCH_LOWER, qos.SENSOR_QOS),
            (WrenchStamped, topics.WRENCH_UPPER, qos.SENSOR_QOS),
            (PolygonStamped, topics.CONTACT_REGION, qos.SENSOR_QOS),
            (Float64MultiArray, topics.CONTACT_PROBABILITIES, qos.SENSOR_QOS),
            (DiagnosticArray, topics.DIAGNOSTICS, qos.COMMAND_QOS),
            *(
                (WrenchStamped, topics.SEGMENT_WRENCHES.format(number), qos.SENSOR_QOS)
                for number in range(1, live.frames.segment_count + 1)
            ),
        )
        refuse = RefusalLog(node)
        for kind, topic, asked in inputs:
            publisher = live.tension_publisher if topic == topics.CABLE_TENSIONS else None
            if publisher is None and asked is qos.SENSOR_QOS:
                publisher = FollowedPublisher()
            take = partial(self._take, topic)
            refuse.subscribe(kind, of_node(estimator, topic), asked, take, publisher)
        quality = qos_profile(qos.COMMAND_QOS)
        self._loads = node.create_publisher(WrenchStamped, topics.APPLIED_WRENCH, quality)
        self._commands = node.create_publisher(JointState, topics.JOINT_COMMANDS, quality)

    def _take(self, topic: str, message: Any) -> None:
        self._live.take(topic, message, time.monotonic())

    @property
    def connected(self) -> bool:
        """Whether all readers read commands, whoever else does."""
        topic = self._commands.topic_name
        endpoints = self._node.get_subscriptions_info_by_topic(topic)
        return self._readers <= {endpoint.node_name for endpoint in endpoints}

    def command(self, command: Array) -> None:
        """Send a command (C,).

        Raises:
            CableSenseError: the machine cannot take it; see `ShownMachine.checked_command`.
        """
        checked = self._live.shown.checked_command(command)
        message = JointState(name=self._command_names)
        message.header.stamp = self._node.get_clock().now().to_msg()
        put_joint_angles(message, checked)
        self._commands.publish(message)

    def push(self, contact: Contact, beside: bool = False) -> None:
        """Put one load on the machine, in place of others or, with `beside`, in addition to them.

        0 N or segment 0 releases.

        Raises:
            LoadError: no such segment or place, or numbers that are not finite.
        """
        for load in self._live.loads_of(contact, beside=beside):
            message = WrenchStamped()
            message.header.stamp = self._node.get_clock().now().to_msg()
            frame, torque_n_m = self._live.load_frame(load)
            message.header.frame_id = frame
            _put(message.wrench.torque, torque_n_m)
            _put(message.wrench.force, load.force_base_n)
            self._loads.publish(message)


def command_readers(shown: ShownMachine, estimator: str, *, commissioner: bool) -> list[str]:
    """Names of the nodes that read commands once all are up.

    The estimator of a machine whose joints are measured reads none.
    """
    readers = ["sim"]
    if not shown.felt.reads_joints:
        readers.append(estimator.split("/")[-1])
    if commissioner:
        readers.append("commissioner")
    return readers


def _put(vector: Any, numbers: Array) -> None:
    vector.x, vector.y, vector.z = (float(number) for number in numbers)
