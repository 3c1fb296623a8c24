"""The node's health on `/diagnostics`, once a second (REP-107)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from cablesense_msgs_py import topics
from cablesense_msgs_py.diagnostics import Status, diagnostic_statuses
from cablesense_msgs_py.qos import PUBLISHER
from cablesense_ros.qos_profiles import overridable, qos_profile

PERIOD_S = 1.0


class DiagnosticsPublisher:
    """Asks `report` once a second for the node's statuses and publishes them."""

    def __init__(
        self,
        node: Node,
        report: Callable[[], Sequence[Status]],
        hardware_id: Callable[[], str],
    ) -> None:
        """`hardware_id` gives the arm's identity, empty while none is loaded."""
        self._node = node
        self._report = report
        self._hardware_id = hardware_id
        self._publisher = node.create_publisher(
            DiagnosticArray,
            topics.DIAGNOSTICS,
            qos_profile(PUBLISHER),
            qos_overriding_options=overridable(),
        )
        node.create_timer(PERIOD_S, self._publish)

    def _publish(self) -> None:
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = diagnostic_statuses(
            self._report(),
            self._node.get_name(),
            self._hardware_id(),
            DiagnosticStatus,
            KeyValue,
        )
        self._publisher.publish(message)
