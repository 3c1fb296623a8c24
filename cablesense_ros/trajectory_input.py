"""A `JointTrajectory` taken as the joint commands that it comes to, one every 20 ms."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from rclpy.node import Node
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from cablesense_base import Array, CableSenseError
from cablesense_msgs_py import topics
from cablesense_msgs_py.qos import COMMAND
from cablesense_msgs_py.topics import ContractError
from cablesense_ros.endpoints import RefusalLog
from cablesense_ros.node_process import steady_timer

PERIOD_S = 0.02


class TrajectoryInput:
    """Positions are interpolated linearly, from the present command on where the first is later.

    A trajectory replaces the one before; one without points stops it, as trajectory controllers
    have it.
    """

    def __init__(
        self,
        node: Node,
        refuse: RefusalLog,
        joint_names: Sequence[str],
        present_rad: Callable[[], Array],
        take: Callable[[JointState], object],
    ) -> None:
        """`take` gets the commands, `present_rad` gives the one in force (2N,)."""
        self._node, self._refuse, self._take = node, refuse, take
        self._joint_names, self._present_rad = list(joint_names), present_rad
        self._command = JointState()
        self._times_s: Array = np.zeros(0)
        self._positions_rad: Array = np.zeros((0, 0))
        self._start_s = 0.0
        self._subscription: Subscription = refuse.subscribe(
            JointTrajectory, topics.JOINT_TRAJECTORY, COMMAND, self._begin
        )
        self._timer = steady_timer(node, PERIOD_S, self._follow)

    def destroy(self) -> None:
        """Take no more."""
        self._node.destroy_subscription(self._subscription)
        self._node.destroy_timer(self._timer)

    def _begin(self, message: JointTrajectory) -> None:
        names, points = list(message.joint_names), message.points
        since = [point.time_from_start for point in points]
        times_s: Array = np.array([one.sec + 1e-9 * one.nanosec for one in since])
        if len(points) and (times_s[0] < 0.0 or (np.diff(times_s) <= 0.0).any()):
            raise ContractError("points: time_from_start must ascend, from 0 on")
        for point in points:
            if len(point.positions) != len(names):
                raise ContractError(
                    f"points: {len(point.positions)} positions for {len(names)} joint names"
                )
        positions_rad: Array = np.array([point.positions for point in points]).reshape(
            len(points), -1
        )
        if len(points) and times_s[0] > 0.0:
            first = dict(zip(names, positions_rad[0], strict=True))
            begun = first | dict(zip(self._joint_names, self._present_rad(), strict=True))
            times_s = np.insert(times_s, 0, 0.0)
            positions_rad = np.vstack([[begun[name] for name in names], positions_rad])
        stamp, now_ns = message.header.stamp, self._node.get_clock().now().nanoseconds
        stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
        late_s = (now_ns - stamp_ns) * 1e-9 if stamp_ns else 0.0
        self._start_s = time.monotonic() - late_s
        self._command.name = names
        self._times_s, self._positions_rad = times_s, positions_rad

    def _follow(self) -> None:
        passed_s = time.monotonic() - self._start_s
        if not len(self._times_s) or passed_s < 0.0:
            return
        columns = self._positions_rad.T
        self._command.position = [np.interp(passed_s, self._times_s, one) for one in columns]
        if passed_s >= self._times_s[-1]:
            self._times_s = np.zeros(0)
        try:
            self._take(self._command)
        except CableSenseError as error:
            self._times_s = np.zeros(0)
            self._refuse(topics.JOINT_TRAJECTORY, error)
