"""The `breather` node: moves the arm a little on purpose, so that friction hides no force."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState

from cablesense_base import Array, CableSenseError
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import (
    BREATH_END,
    Level,
    NamedOrder,
    Status,
    breath_frame,
    breath_turn,
    joint_command_rad,
    put_joint_angles,
)
from cablesense_msgs_py.qos import COMMAND_QOS
from cablesense_online.breathing import (
    SET_POINTS_A_TURN,
    Breath,
    BreathError,
    breath_circle,
    offsets_m,
)
from cablesense_ros.endpoints import RefusalLog, qos_profile, serve
from cablesense_ros.node_process import (
    declare_parameters,
    parameter_table,
    publish_diagnostics,
    run_node,
)
from cablesense_sim.arm import open_arm
from cablesense_sim.compiled import leave_interpreted


class BreatherNode(Node):
    """Breathes about the last command of others: once on request, or all the time."""

    def __init__(self) -> None:
        super().__init__("breather")
        self._given = declare_parameters(self, parameter_table("breather"))
        settings = self._given
        self._arm = open_arm(settings["arm"])
        arm = self._arm
        self._joints = NamedOrder(arm.joint_names, "joints")
        self._by_joints = settings["over"] == topics.JOINT_COMMANDS
        names = arm.joint_names if self._by_joints else arm.cable_names
        self._message = JointState(name=list(names))
        self._base_rad: Array | None = None
        if not settings["await_command"]:
            self._base_rad = np.zeros(arm.joint_count)
        self._commanded_ns = 0
        self._due_ns = 0
        self._breath: Breath | None = None
        self._problem = ""
        self._count = 0
        self._tick_ns = round(settings["turn_s"] * 1e9 / SET_POINTS_A_TURN)
        self._out = self.create_publisher(JointState, settings["over"], qos_profile(COMMAND_QOS))
        self._refuse = RefusalLog(self)
        self._refuse.subscribe(JointState, topics.JOINT_COMMANDS, COMMAND_QOS, self._on_command)
        serve(self, topics.BREATHE, self._breathe_once)
        self.create_timer(0.5e-9 * self._tick_ns, self._tick)
        publish_diagnostics(self, self._statuses, lambda: arm.identity)
        self.get_logger().info(f"arm {arm.identity}: breathes over {settings['over']}")

    def destroy_node(self) -> None:
        """Leaves the arm where it was commanded."""
        if self._breath is not None:
            self._send(np.zeros(self._arm.joint_count), BREATH_END, self._now_ns())
        super().destroy_node()

    def _on_command(self, message: JointState) -> None:
        if breath_turn(message) is not None:
            return
        command_rad = joint_command_rad(message, self._joints, self._base_rad)
        if self._base_rad is not None and np.array_equal(command_rad, self._base_rad):
            return
        self._base_rad, self._commanded_ns = command_rad, self._now_ns()
        if self._breath is not None:
            self._breath = None
            self._send(np.zeros(self._arm.joint_count), BREATH_END, self._commanded_ns)
            self._problem = "the last breath was cut short by a command"

    def _breathe_once(self) -> str:
        if self._breath is not None:
            raise BreathError("the arm is breathing already; wait until it has ended")
        return self._begin(self._given["turns"])

    def _begin(self, turns: int) -> str:
        """Begin to breathe, with this number of turns; gives the amplitude as text.

        Raises:
            CableSenseError: there is no breath for this arm here, or not now.
        """
        settings = self._given
        if self._base_rad is None:
            raise BreathError(
                f"no command on {topics.JOINT_COMMANDS} yet, so the pose to breathe about is "
                "unknown; send the one that the arm is at"
            )
        waited_s = 1e-9 * (self._now_ns() - self._commanded_ns)
        if waited_s < settings["rest_s"]:
            raise BreathError(
                f"commanded {waited_s:.1f} s ago; a breath begins {settings['rest_s']:g} s after "
                "a command (rest_s) at the earliest"
            )
        limits = settings["amplitude_rad"], 1e-3 * settings["largest_tip_mm"]
        circle = breath_circle(self._arm, self._base_rad, *limits)
        self._breath, self._due_ns = Breath(circle, turns), self._now_ns()
        self._problem = ""
        return (
            f"joints turn by up to {np.degrees(circle.largest_rad):.2f} degrees, the tip by "
            f"{1e3 * circle.tip_m:.2f} mm"
        )

    def _tick(self) -> None:
        now_ns = self._now_ns()
        if self._breath is None and self._given["continuous"]:
            try:
                self._begin(0)
            except CableSenseError as error:
                self._problem = str(error)
        latest = None
        while self._breath is not None and self._due_ns <= now_ns:
            latest = *self._breath.next(), self._due_ns
            self._due_ns += self._tick_ns
            if self._breath.over:
                self._breath = None
                self._count = self._count + 1
        if latest is not None:
            self._send(*latest)

    def _send(self, deviation_rad: Array, turn: int, stamp_ns: int) -> None:
        message = self._message
        base_rad = self._base_rad
        assert base_rad is not None  # or there would be no breath
        message.header.frame_id = breath_frame(turn)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        if self._by_joints:
            put_joint_angles(message, base_rad + deviation_rad)
        else:
            put_joint_angles(message, offsets_m(self._arm, base_rad, deviation_rad))
        self._out.publish(message)

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _statuses(self) -> list[Status]:
        values = {"breaths": str(self._count), "over": self._given["over"]}
        if self._problem:
            return [Status("breathing", Level.WARN, self._problem, values)]
        message = "at rest" if self._breath is None else "breathing"
        return [Status("breathing", Level.OK, message, values)]


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    leave_interpreted()
    return run_node(BreatherNode, args)


if __name__ == "__main__":
    sys.exit(main())
