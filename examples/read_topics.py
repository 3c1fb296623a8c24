"""Reads the estimator's topics: what each wrench means, and the force that belongs to it.

    python -m examples.read_topics  # while `cablesense demo` runs, in its ROS_DOMAIN_ID

It uses rclpy and the standard messages alone, as a node of another package would.
"""

from __future__ import annotations

import math
import signal
import sys
import threading
from collections.abc import Callable
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions

PERIOD_S = 0.5


class ReadTopics(Node):
    """Prints state and force twice a second."""

    def __init__(self, name: str = "read_topics") -> None:
        super().__init__(name)
        self.state = "silent"
        self.rival = ""
        self.wrench = WrenchStamped()
        self.listen(WrenchStamped, "estimator/wrench", self._on_wrench)
        self.listen(DiagnosticArray, "estimator/status", self._on_status)
        self.create_timer(PERIOD_S, lambda: print(self.line(), flush=True))

    def listen(self, kind: type, topic: str, on_message: Callable[[Any], None]) -> None:
        """Subscribe as readers of sensor data do."""
        self.create_subscription(kind, topic, on_message, qos_profile_sensor_data)

    def force_n(self) -> float:
        """Size of the force in the last wrench."""
        force = self.wrench.wrench.force
        return math.hypot(force.x, force.y, force.z)

    def line(self) -> str:
        """State and force as text; a zero wrench alone does not say that nothing touches."""
        if self.state not in ("contact", "unconfirmed"):
            return self.state
        force = self.wrench.wrench.force
        frame = self.wrench.header.frame_id
        line = f"{self.state} on {frame}: ({force.x:.2f}, {force.y:.2f}, {force.z:.2f}) N"
        return f"{line}, or: {self.rival}" if self.rival else line

    def _on_wrench(self, message: WrenchStamped) -> None:
        self.wrench = message

    def _on_status(self, message: DiagnosticArray) -> None:
        status = message.status[0]
        self.state = status.message
        self.rival = next((pair.value for pair in status.values if pair.key == "or"), "")


def spin(make_node: Callable[[], Node]) -> int:
    """Run a node until Ctrl-C, which ends no callback halfway."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    ended = threading.Event()
    for end in (signal.SIGINT, signal.SIGTERM):
        signal.signal(end, lambda *_: ended.set())
    node = make_node()
    while not ended.is_set():
        rclpy.spin_once(node, timeout_sec=0.2)
    rclpy.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(spin(ReadTopics))
