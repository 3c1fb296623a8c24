"""The `can_driver` node: the real arm's tensions from a CAN bus (a lifecycle node)."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Final

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState

from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import Level, Status, put_tensions
from cablesense_msgs_py.qos import PUBLISHER
from cablesense_msgs_py.topics import Frames
from cablesense_online.can.bus import CanInterface
from cablesense_online.can.calibration import (
    Calibration,
    calibrated,
    calibration_status,
    load_calibration,
)
from cablesense_online.can.channel_map import open_channel_map
from cablesense_online.can.decoder import Sample
from cablesense_online.can.driver import CanDriver
from cablesense_ros.node_process import (
    ARM,
    AUTOSTART,
    BITRATE,
    CHANNEL_MAP,
    FRAME_PREFIX,
    ConfiguredNode,
    DiagnosticsPublisher,
    NodeParameter,
    declare_parameters,
    overridable,
    parameter_values,
    run_configured_node,
)
from cablesense_sim.arm import open_arm

CAN_DRIVER_PARAMETERS: Final = (
    ARM,
    AUTOSTART,
    FRAME_PREFIX,
    CHANNEL_MAP,
    BITRATE,
    NodeParameter(
        "calibration",
        "",
        "Path of a calibration file, whose scales and zeros take the place of the map's; empty "
        "for none.",
    ),
    NodeParameter(
        "interface",
        "socketcan",
        "python-can's name of the kind of adapter: socketcan, slcan, pcan, kvaser, virtual, "
        "udp_multicast.",
    ),
    NodeParameter(
        "channel", "can0", "What that kind calls its channels: can0, /dev/ttyACM0, PCAN_USBBUS1."
    ),
    NodeParameter(
        "stale_after_s", 0.2, "Without a sample this long diagnostics are stale, s.", 0.001, 60.0
    ),
)


class CanDriverNode(ConfiguredNode):
    """Configured: map, DBC file and arm read. Active: the bus is read and samples are published.

    Nothing downstream can tell it from the sim node: the message, its names, frame and quality of
    service are the same. Without a whole sample there is no message.
    """

    def __init__(self) -> None:
        super().__init__("can_driver")
        declare_parameters(self, CAN_DRIVER_PARAMETERS, read_only=False)
        self._tensions = JointState()
        self._tensions_out: Publisher | None = None
        self._driver: CanDriver | None = None
        self._calibration: Calibration | None = None
        self._arm_identity = ""
        self._active = False
        DiagnosticsPublisher(self, self._statuses, lambda: self._arm_identity)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the bus; an interface that is not there is waited for."""
        result = super().on_activate(state)
        self._active = True
        if self._driver is not None:
            self._driver.start()
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the interface."""
        self._stop()
        return super().on_deactivate(state)

    def destroy_node(self) -> None:
        """Close the interface first: its thread publishes."""
        self._stop()
        super().destroy_node()

    def _configure(self) -> None:
        given = parameter_values(self, CAN_DRIVER_PARAMETERS)
        arm = open_arm(given["arm"])
        channel_map, database = open_channel_map(given["map"])
        channel_map = channel_map.arranged(arm.cable_names)
        if given["calibration"]:
            self._calibration = load_calibration(given["calibration"])
            channel_map = calibrated(
                channel_map, database, self._calibration, given["calibration"]
            )
        interface = CanInterface(given["interface"], given["channel"], given["bitrate_bit_s"])
        self._tensions = JointState(name=list(arm.cable_names))
        self._tensions.header.frame_id = Frames(arm.segment_count, given["frame_prefix"]).base
        self._tensions_out = self.create_publisher(
            JointState, topics.CABLE_TENSIONS, **overridable(PUBLISHER)
        )
        self._driver = CanDriver(channel_map, database, interface, self._publish)
        self._arm_identity = arm.identity
        self.get_logger().info(
            f"arm {arm.identity}: map {channel_map.name} with {len(channel_map.channels)} "
            f"channels on {interface.name}, scales and zeros: "
            f"{calibration_status(self._calibration).message}"
        )

    def _publish(self, sample: Sample) -> None:
        """In the receiving thread, as a turn through the executor would cost latency."""
        if self._tensions_out is None:
            return
        whole_s = int(sample.time_s)
        stamp = self._tensions.header.stamp
        stamp.sec, stamp.nanosec = whole_s, min(int((sample.time_s - whole_s) * 1e9), 999_999_999)
        put_tensions(self._tensions, sample.tensions_n)
        self._tensions_out.publish(self._tensions)

    def _stop(self) -> None:
        self._active = False
        if self._driver is not None:
            self._driver.stop()

    def _release(self) -> None:
        self._stop()
        if self._tensions_out is not None:
            self.destroy_publisher(self._tensions_out)
        self._driver, self._tensions_out, self._arm_identity = None, None, ""
        self._calibration = None

    def _statuses(self) -> list[Status]:
        if self._driver is None:
            return [Status("interface", Level.WARN, "not configured: no channel map read")]
        if not self._active:
            return [Status("interface", Level.OK, "configured, not active: the bus is not read")]
        statuses, faults = self._driver.report(self.get_parameter("stale_after_s").value)
        for kind in faults.recent:
            self.get_logger().warning(f"{kind.value}: {faults.last[kind]}")
        return [*statuses, calibration_status(self._calibration)]


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; the process's exit code."""
    return run_configured_node(CanDriverNode, args)


if __name__ == "__main__":
    sys.exit(main())
