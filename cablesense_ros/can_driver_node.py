"""The `can_driver` node: the real arm's tensions from a CAN bus (a lifecycle node)."""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState

from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import (
    Level,
    NamedOrder,
    Status,
    joint_command_rad,
    put_joint_angles,
    put_tensions,
)
from cablesense_msgs_py.topics import Frames
from cablesense_online.can.assembler import AssembledSample
from cablesense_online.can.bus import CanInterface
from cablesense_online.can.channel_map import (
    SensorScales,
    load_sensor_scales,
    open_channel_map,
    sensor_scales_status,
    with_sensor_scales,
)
from cablesense_online.can.driver import CanDriver
from cablesense_ros.endpoints import CommandInput, RefusalLog, steady_timer
from cablesense_ros.node_process import ConfiguredNode, run_node
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.joint_motion import JointMotion

JOINT_STATES_PERIOD_S = 0.02
"""From one `joint_states` to the next: they are for display."""


class CanDriverNode(ConfiguredNode):
    """Configured: map, DBC file and arm read. Active: the bus is read and samples are published.

    Nothing downstream can tell it from the sim node: the message, its names, frame and quality of
    service are the same. Without a whole sample there is no message. An arm without sensors in its
    joints is shown where it was commanded: `joint_states` are the set-points.
    """

    def __init__(self) -> None:
        super().__init__("can_driver")
        self._scales: SensorScales | None = None
        self._refuse = RefusalLog(self)

    def _begin(self) -> None:
        """Read the bus; an interface that is not there is waited for."""
        self._while_active.callback(self._driver.stop)
        self._driver.start()

    def _configure(self, given: dict[str, Any]) -> None:
        arm = open_arm(given["arm"])
        channel_map, database = open_channel_map(given["map"])
        channel_map = channel_map.arranged(arm.cable_names)
        self._scales = None
        if given["sensor_calibration_file"]:
            self._scales = load_sensor_scales(given["sensor_calibration_file"])
            channel_map = with_sensor_scales(
                channel_map, database, self._scales, given["sensor_calibration_file"]
            )
        if given["joint_states"]:
            self._show_set_points(arm, given["joint_speed_rad_s"])
        interface = CanInterface(given["interface"], given["channel"], given["bitrate_bit_s"])
        self._tensions = JointState(name=list(arm.cable_names))
        self._tensions.header.frame_id = Frames(arm.segment_count, given["frame_prefix"]).base
        self._tensions_out = self._topics.make(JointState, topics.CABLE_TENSIONS)
        self._driver = CanDriver(channel_map, database, interface, self._publish)
        self._identity = arm.identity
        self.get_logger().info(
            f"arm {arm.identity}: map {channel_map.name} with {len(channel_map.channels)} "
            f"channels on {interface.name}, scales and zeros: "
            f"{sensor_scales_status(self._scales).message}"
        )

    def _show_set_points(self, arm: Arm, speed_rad_s: float) -> None:
        """Publish the set-points of an arm that is straight until it is commanded."""
        joints = NamedOrder(arm.joint_names, "joints")
        self._set_points = JointMotion.at_rest(np.zeros(arm.joint_count), speed_rad_s)
        shown = JointState(name=list(arm.joint_names))
        out = self._topics.make(JointState, topics.JOINT_STATES)

        def publish() -> None:
            self._set_points = self._set_points.after(JOINT_STATES_PERIOD_S)
            put_joint_angles(shown, self._set_points.angle_rad)
            shown.header.stamp = self.get_clock().now().to_msg()
            out.publish(shown)

        def follow(message: JointState) -> None:
            target_rad = joint_command_rad(message, joints, self._set_points.target_rad)
            self._set_points = self._set_points.towards(target_rad)

        commands = CommandInput(
            self, self._refuse, arm.joint_names, lambda: self._set_points.target_rad, follow
        )
        self._entities.callback(commands.destroy)
        timer = steady_timer(self, JOINT_STATES_PERIOD_S, publish)
        self._entities.callback(self.destroy_timer, timer)

    def _publish(self, sample: AssembledSample) -> None:
        """In the receiving thread, as a turn through the executor would cost latency."""
        whole_s = int(sample.time_s)
        stamp = self._tensions.header.stamp
        stamp.sec = whole_s
        stamp.nanosec = min(int((sample.time_s - whole_s) * 1e9), 999_999_999)
        put_tensions(self._tensions, sample.tensions_n)
        self._tensions_out.publish(self._tensions)

    def _statuses(self) -> list[Status]:
        if not self._identity:
            return [Status("interface", Level.WARN, "not configured: no channel map read")]
        if not self._active:
            return [Status("interface", Level.OK, "configured, not active: the bus is not read")]
        statuses, faults = self._driver.report(self.get_parameter("stale_after_s").value)
        for kind in faults.recent:
            self.get_logger().warning(f"{kind.value}: {faults.last[kind]}")
        return [*statuses, sensor_scales_status(self._scales)]


main = partial(run_node, CanDriverNode)


if __name__ == "__main__":
    sys.exit(main())
