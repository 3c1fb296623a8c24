"""Subscriptions to all that the contract says of a running arm, for who shows or records it."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from cablesense_msgs_py import qos, topics
from cablesense_msgs_py.errors import CableSenseError
from cablesense_ros.page.live_arm import LiveArm
from cablesense_ros.qos_profiles import overridable, qos_profile
from cablesense_ros.throttled_log import ThrottledLog


def of_node(node_name: str, topic: str) -> str:
    """A private topic (`~/…`) of a node, as another node names it."""
    return topic.replace("~", node_name, 1)


def listen_to_arm(node: Node, live: LiveArm, estimator: str) -> None:
    """Subscribes `node` to arm and estimator; every message goes to `live`.

    What breaks the contract is logged.
    """
    warn = ThrottledLog(node.get_logger().warning, time.monotonic)
    now = time.monotonic
    wrench = of_node(estimator, topics.WRENCH)
    probabilities = of_node(estimator, topics.CONTACT_PROBABILITIES)

    def take(topic: str, handle: Callable[[Any], None], message: Any) -> None:
        try:
            handle(message)
        except CableSenseError as error:
            warn(topic, f"{topic}: {error}")

    inputs: tuple[tuple[type, str, qos.Qos, Callable[[Any], None]], ...] = (
        (JointState, topics.CABLE_TENSIONS, qos.SENSOR, lambda m: live.on_tensions(m, now())),
        (JointState, topics.JOINT_STATES, qos.SENSOR, live.on_joint_states),
        (JointState, topics.JOINT_COMMANDS, qos.COMMAND, live.on_joint_commands),
        (WrenchStamped, topics.APPLIED_WRENCH, qos.COMMAND, live.on_load),
        (WrenchStamped, wrench, qos.SENSOR, lambda m: live.on_wrench(m, now())),
        (Float64MultiArray, probabilities, qos.SENSOR, live.on_probabilities),
        (
            DiagnosticArray,
            topics.DIAGNOSTICS,
            qos.COMMAND,
            lambda m: live.on_diagnostics(m, now()),
        ),
    )
    for kind, topic, profile, handle in inputs:
        node.create_subscription(
            kind,
            topic,
            partial(take, topic, handle),
            qos_profile(profile),
            qos_overriding_options=overridable(),
        )
