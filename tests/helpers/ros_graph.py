"""Real nodes in processes of their own, and one here that talks to them."""

from __future__ import annotations

import time
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.srv import ChangeState
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.subscription import Subscription
from rclpy.time import Time
from rclpy.utilities import try_shutdown
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from cablesense_msgs_py.messages import ForceState, read_force_state
from cablesense_ros.processes import Process, node_command

PATIENCE_S = 60.0
"""For a machine that is busy with other work; what is waited for comes at once elsewhere."""
END_WITHIN_S = 75.0
"""Longer than the alarm that ends a node which Fast DDS does not let go."""


class NodeProcess(Process):
    """One node started as a user would start it."""

    def __init__(
        self,
        log: Path,
        name: str,
        namespace: str = "",
        remaps: dict[str, str] | None = None,
        **parameters: object,
    ) -> None:
        given = {key.replace("__", "."): value for key, value in parameters.items()}
        super().__init__(name, node_command(name, given, remaps, namespace), log)

    def wait(self, within_s: float | None = END_WITHIN_S) -> int:
        """Its exit code, once it has ended by itself."""
        return super().wait(within_s)


class Graph:
    """A node in this process: receives everything, can publish and call."""

    def __init__(self) -> None:
        try_shutdown()  # one that a failed test left behind
        rclpy.init()
        self.node = Node("test")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.wrenches: list[WrenchStamped] = []
        self.states: dict[int, ForceState] = {}
        self.tensions: list[JointState] = []
        self.descriptions: list[String] = []
        self.statuses: dict[str, object] = {}
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        listen = self.node.create_subscription
        listen(WrenchStamped, "/estimator/wrench", self.wrenches.append, 100)
        listen(DiagnosticArray, "/estimator/status", self._on_state, 100)
        listen(JointState, "/cable_tensions", self.tensions.append, qos_profile_sensor_data)
        listen(String, "/robot_description", self.descriptions.append, latched)
        listen(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self.load = self.node.create_publisher(WrenchStamped, "/applied_wrench", 10)
        self.command = self.node.create_publisher(JointState, "/joint_commands", 10)
        self._heard: list[Subscription] = []

    def _on_state(self, message: DiagnosticArray) -> None:
        state, stamp_ns = read_force_state(message)
        self.states[stamp_ns] = state

    def state_of(self, wrench: WrenchStamped) -> ForceState | None:
        """What a wrench stands for, once that has come."""
        return self.states.get(Time.from_msg(wrench.header.stamp).nanoseconds)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.statuses.update({status.name: status for status in message.status})

    def listen(self, kind: type, topic: str) -> list:
        """The messages of a topic, from when its publisher is known until `forget`."""
        received: list = []
        subscription = self.node.create_subscription(kind, topic, received.append, 100)
        self._heard.append(subscription)
        self.until(lambda: self.node.count_publishers(subscription.topic_name), topic)
        return received

    def forget(self) -> None:
        """End what `listen` began: each message costs this process time."""
        while self._heard:
            self.node.destroy_subscription(self._heard.pop())

    def until(self, condition, what: str) -> None:
        """Spin until something is true."""
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, f"waited {PATIENCE_S:g} s in vain for {what}"
            self.executor.spin_once(timeout_sec=0.05)

    def spin(self, seconds: float) -> None:
        """Spin for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)

    def push(self, segment: int, force_base_n) -> None:
        """Put a load on a segment."""
        self.until(self.load.get_subscription_count, "a subscriber of loads")
        message = WrenchStamped()
        message.header.frame_id = f"segment_{segment}"
        force = message.wrench.force
        force.x, force.y, force.z = map(float, force_base_n)
        self.load.publish(message)

    def release(self) -> None:
        """Take all loads away."""
        for segment in (1, 2, 3, 4):
            self.push(segment, (0.0, 0.0, 0.0))

    def call(self, service: str) -> Trigger.Response:
        """Call a Trigger service."""
        client = self.node.create_client(Trigger, service)
        self.until(client.service_is_ready, service)
        future = client.call_async(Trigger.Request())
        self.until(future.done, f"an answer of {service}")
        self.node.destroy_client(client)
        return future.result()

    def change_state(self, node: str, transition: int) -> bool:
        """Send a lifecycle node through a transition; give whether it succeeded."""
        client = self.node.create_client(ChangeState, f"{node}/change_state")
        self.until(client.service_is_ready, f"{node}/change_state")
        request = ChangeState.Request()
        request.transition.id = transition
        future = client.call_async(request)
        self.until(future.done, f"transition {transition} of {node}")
        self.node.destroy_client(client)
        return future.result().success

    def close(self) -> None:
        """Leave, once others' ends are known: Fast DDS may hang while it learns of one."""
        self.executor.shutdown()
        time.sleep(0.1)
        self.node.destroy_node()
        try_shutdown()


def force(wrench: WrenchStamped) -> tuple[float, float, float]:
    """Its force as a tuple."""
    return (wrench.wrench.force.x, wrench.wrench.force.y, wrench.wrench.force.z)
