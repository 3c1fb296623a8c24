"""Someone outside who pushes the arm and watches what comes of it."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from geometry_msgs.msg import WrenchStamped
from numpy.typing import NDArray
from rclpy.event_handler import QoSLivelinessChangedInfo, SubscriptionEventCallbacks
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import JointState

from cablesense_msgs_py.qos import Qos
from cablesense_ros.qos_profiles import qos_profile
from cablesense_sim.arm import Arm

LEASE_S = 0.08
"""Without a sign of life of the estimator for so long, this subscriber's middleware says so."""

LOAD_EVERY_S = 0.05
COMMAND_EVERY_S = 0.5
TOLERANCE_N, TOLERANCE = 2.0, 0.03
"""A wrench is right when its force is no further from the load than the larger of these."""

DEEP = Qos(depth=2000, reliable=True)
WATCHED = Qos(depth=2000, reliable=True, lease_s=LEASE_S)


class Heard(NamedTuple):
    """One wrench: when it came, what its stamp says (s since the epoch), segment and force."""

    arrived_s: float
    arrived_epoch_s: float
    stamp_s: float
    segment: int
    force_n: tuple[float, float, float]

    @property
    def zero(self) -> bool:
        """Whether it says that nothing touches."""
        return self.segment == 0 and not any(self.force_n)


class Watcher(Node):
    """Publishes the present load and command again and again, notes every wrench and sample.

    Times are monotonic.

    Attributes:
        wrenches: since `forget`.
        samples: stamps of all samples heard, ns.
        last_sample_s: when the last one came.
        liveliness: (when, how many estimators are alive) since `forget`.
        load_since_s: when the present load was first published.
    """

    def __init__(self, arm: Arm) -> None:
        super().__init__("watcher")
        self.wrenches: list[Heard] = []
        self.samples: list[int] = []
        self.sample_s: list[float] = []
        self.liveliness: list[tuple[float, int]] = []
        self._load = WrenchStamped()
        self._load.header.frame_id = "segment_1"
        self._force_n: NDArray[np.float64] = np.zeros(3)
        self._segment, self._segment_count = 1, arm.segment_count
        self.load_since_s = time.monotonic()
        self._command = JointState(
            name=list(arm.joint_names), position=[0.0] * len(arm.joint_names)
        )
        self._load_out = self.create_publisher(WrenchStamped, "applied_wrench", 10)
        self._command_out = self.create_publisher(JointState, "joint_commands", 10)
        self.create_timer(LOAD_EVERY_S, self._say_load)
        self.create_timer(COMMAND_EVERY_S, self._say_command)
        self.create_subscription(
            WrenchStamped,
            "estimator/wrench",
            self._on_wrench,
            qos_profile(WATCHED),
            event_callbacks=SubscriptionEventCallbacks(liveliness=self._on_liveliness),
        )
        self.create_subscription(JointState, "cable_tensions", self._on_sample, qos_profile(DEEP))

    def push(self, segment: int, force_base_n: NDArray[np.float64]) -> None:
        """Push there instead of where it was pushed before."""
        before = self._segment
        self._segment, self._force_n = segment, force_base_n
        if before != segment:
            self._publish(before, np.zeros(3))
        self._say_load()
        self.load_since_s = time.monotonic()

    def right(self, heard: Heard) -> bool:
        """Whether a wrench tells the present load. The arm is straight: base axes are its own."""
        off_n = float(np.linalg.norm(np.array(heard.force_n) - self._force_n))
        limit_n = max(TOLERANCE_N, TOLERANCE * float(np.linalg.norm(self._force_n)))
        return heard.segment == self._segment and off_n <= limit_n

    def forget(self) -> None:
        """Begin to note anew."""
        self.wrenches.clear()
        self.liveliness.clear()
        del self.sample_s[:-1]

    def spin(self, executor: Executor, seconds: float) -> None:
        """Let callbacks run for a while."""
        executor.spin_until_future_complete(Future(), timeout_sec=seconds)

    def _say_load(self) -> None:
        for segment in range(1, self._segment_count + 1):
            self._publish(segment, self._force_n if segment == self._segment else np.zeros(3))

    def _publish(self, segment: int, force_n: NDArray[np.float64]) -> None:
        self._load.header.frame_id = f"segment_{segment}"
        force = self._load.wrench.force
        force.x, force.y, force.z = force_n.tolist()
        self._load_out.publish(self._load)

    def _say_command(self) -> None:
        self._command.header.stamp = self.get_clock().now().to_msg()
        self._command_out.publish(self._command)

    def _on_wrench(self, message: WrenchStamped) -> None:
        force, stamp = message.wrench.force, message.header.stamp
        frame = message.header.frame_id
        self.wrenches.append(
            Heard(
                time.monotonic(),
                time.time(),
                stamp.sec + stamp.nanosec * 1e-9,
                int(frame.rpartition("_")[2]) if frame.startswith("segment_") else 0,
                (force.x, force.y, force.z),
            )
        )

    def _on_sample(self, message: JointState) -> None:
        stamp = message.header.stamp
        self.samples.append(stamp.sec * 1_000_000_000 + stamp.nanosec)
        self.sample_s.append(time.monotonic())

    def _on_liveliness(self, event: QoSLivelinessChangedInfo) -> None:
        self.liveliness.append((time.monotonic(), event.alive_count))
