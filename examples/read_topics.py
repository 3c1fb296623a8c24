"""Reads the estimator's topics: what each wrench means, and the force while it is known.

    python -m examples.read_topics          # with `cablesense demo`, in the same ROS_DOMAIN_ID

It uses rclpy and the standard messages alone, as a node of another package would.
"""

from __future__ import annotations

import sys

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

PERIOD_S = 0.5


class ReadTopics(Node):
    """Prints state and force twice a second."""

    def __init__(self) -> None:
        super().__init__("read_topics")
        self.state, self.wrench = "silent", WrenchStamped()
        listen = self.create_subscription
        listen(WrenchStamped, "estimator/wrench", self._on_wrench, qos_profile_sensor_data)
        listen(DiagnosticArray, "estimator/status", self._on_status, qos_profile_sensor_data)
        self.create_timer(PERIOD_S, lambda: print(self.line(), flush=True))

    def line(self) -> str:
        """State and force as text; a zero wrench alone does not say that nothing touches."""
        if self.state != "contact":
            return self.state
        force = self.wrench.wrench.force
        frame = self.wrench.header.frame_id
        return f"contact on {frame}: ({force.x:.2f}, {force.y:.2f}, {force.z:.2f}) N"

    def _on_wrench(self, message: WrenchStamped) -> None:
        self.wrench = message

    def _on_status(self, message: DiagnosticArray) -> None:
        self.state = message.status[0].message


def main() -> int:
    """Read until Ctrl-C."""
    rclpy.init()
    try:
        rclpy.spin(ReadTopics())
    except KeyboardInterrupt:
        pass
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
