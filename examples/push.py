"""Pushes a simulated arm or machine at the middle of a link, where there is no `ros2 topic pub`.

    python -m examples.push distal 0 0 1.5  # link, then N in the axes of the base; 0 0 0 releases

The load is a wrench in the frame of the link. It runs in the ROS_DOMAIN_ID of the nodes.
"""

from __future__ import annotations

import argparse
import sys
import time

import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node

PATIENCE_S = 20.0
"""Nodes on one network find each other within seconds."""
SENDING_S = 0.2
"""A message that is on its way when its node ends may be lost."""


def push(frame: str, x_n: float, y_n: float, z_n: float) -> bool:
    """Publish the load once somebody takes loads; whether anybody did."""
    node = Node("push")
    publisher = node.create_publisher(WrenchStamped, "applied_wrench", 1)
    until_s = time.monotonic() + PATIENCE_S
    while not publisher.get_subscription_count():
        if time.monotonic() > until_s:
            return False
        rclpy.spin_once(node, timeout_sec=0.1)
    load = WrenchStamped()
    load.header.frame_id = frame
    load.wrench.force.x = x_n
    load.wrench.force.y = y_n
    load.wrench.force.z = z_n
    publisher.publish(load)
    time.sleep(SENDING_S)
    return True


def main() -> int:
    """Reads the command line; exit code 1 if no simulator takes loads."""
    parser = argparse.ArgumentParser(description="Pushes a simulated arm or machine at a link.")
    parser.add_argument("link", help="frame of the link that is pushed")
    for axis in "xyz":
        parser.add_argument(axis, type=float, help=f"force along {axis} of the base, N")
    given = parser.parse_args()
    rclpy.init()
    taken = push(given.link, given.x, given.y, given.z)
    rclpy.shutdown()
    if not taken:
        print("no simulator takes loads here: start one, and set its ROS_DOMAIN_ID")
    return 0 if taken else 1


if __name__ == "__main__":
    sys.exit(main())
