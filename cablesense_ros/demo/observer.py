"""The node of a headless demo: pushes after the script and writes down what the estimator says."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial

import numpy as np
import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from cablesense_base.arrays import Array
from cablesense_msgs_py import qos, topics
from cablesense_msgs_py.joint_states import put_joint_angles
from cablesense_msgs_py.wrenches import Load
from cablesense_online.page.live_arm import LiveArm
from cablesense_online.page.snapshot import Level, Snapshot
from cablesense_ros.demo.script import Record, ScriptedPush
from cablesense_ros.discovery import prefer_quick_discovery
from cablesense_ros.endpoints import qos_profile
from cablesense_ros.subscriptions import listen_to_arm
from cablesense_sim.arm import Arm

JOINT_SPEED_RAD_S = float(np.deg2rad(20.0))
RECORD_EVERY_S = 0.04


class Observer:
    """Pushes and commands, and knows the present; its node runs in a thread until `close`."""

    def __init__(self, arm: Arm) -> None:
        prefer_quick_discovery()
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("demo")
        self._joint_names = list(arm.joint_names)
        self.live = LiveArm(arm, joint_speed_rad_s=JOINT_SPEED_RAD_S)
        listen_to_arm(self._node, self.live, "estimator")
        profile = qos_profile(qos.COMMAND)
        self._loads = self._node.create_publisher(WrenchStamped, topics.APPLIED_WRENCH, profile)
        self._commands = self._node.create_publisher(JointState, topics.JOINT_COMMANDS, profile)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, name="demo observer", daemon=True)
        self._thread.start()

    @property
    def connected(self) -> bool:
        """Whether simulator and estimator listen: with this node, a command has three readers."""
        return self._commands.get_subscription_count() >= 3

    def snapshot(self) -> Snapshot:
        """The present."""
        return self.live.snapshot(time.monotonic())

    def push(self, segment: int, angle_deg: float, magnitude_n: float) -> None:
        """Puts one load on the arm in place of any other; 0 N releases."""
        for load in self.live.loads_of(segment, angle_deg, magnitude_n):
            self._loads.publish(self._message(load))

    def command(self, joint_angles_rad: Array) -> None:
        """Sends joint angles (2N,)."""
        message = JointState(name=self._joint_names)
        message.header.stamp = self._node.get_clock().now().to_msg()
        put_joint_angles(message, joint_angles_rad)
        self._commands.publish(message)

    def close(self) -> None:
        """Ends the node and its thread."""
        self._executor.shutdown()
        self._thread.join(timeout=2.0)
        self._node.destroy_node()
        rclpy.try_shutdown()

    def _message(self, load: Load) -> WrenchStamped:
        message = WrenchStamped()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.header.frame_id = self.live.frames.segment(load.segment)
        force = message.wrench.force
        force.x, force.y, force.z = (float(component) for component in load.force_base_n)
        return message

    def _spin(self) -> None:
        with suppress(ExternalShutdownException):
            self._executor.spin()


def play(
    observer: Observer,
    script: Sequence[ScriptedPush],
    check: Callable[[], None],
    progress: Callable[[float], None],
) -> Record:
    """Plays the script in real time.

    Args:
        observer: pushes and watches.
        script: what to do when.
        check: called at every step; raises to end the play.
        progress: told the seconds since the start.
    """
    start = time.monotonic()
    times, snapshots = [], []
    todo = _events(observer, script)
    end_s = script[-1].end_s
    while (now_s := time.monotonic() - start) < end_s:
        check()
        while todo and todo[0][0] <= now_s:
            todo.pop(0)[1]()
        snapshots.append(observer.snapshot())
        times.append(now_s)
        progress(now_s)
        time.sleep(RECORD_EVERY_S)
    observer.push(script[-1].segment, 0.0, 0.0)
    heard = np.array([snapshot.status.level is not Level.STALE for snapshot in snapshots])
    return Record(np.array(times), snapshots, heard)


def _events(
    observer: Observer, script: Sequence[ScriptedPush]
) -> list[tuple[float, Callable[[], None]]]:
    events: list[tuple[float, Callable[[], None]]] = []
    before = np.zeros_like(script[0].command_rad)
    for push in script:
        if not np.array_equal(push.command_rad, before):
            events.append((push.move_s, partial(observer.command, push.command_rad)))
            before = push.command_rad
        events.append(
            (
                push.start_s,
                partial(observer.push, push.segment, push.angle_deg, push.magnitude_n),
            )
        )
        events.append((push.end_s, partial(observer.push, push.segment, 0.0, 0.0)))
    return sorted(events, key=lambda event: event[0])
