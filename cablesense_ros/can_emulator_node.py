"""The `can_emulator` node: a simulated or recorded arm as CAN frames, with faults on request."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, Final

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState

from cablesense_base.errors import CableSenseError
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import Level, NamedOrder, Status, put_joint_angles
from cablesense_msgs_py.qos import PUBLISHER, SENSOR
from cablesense_online.can.bus import CanInterface
from cablesense_online.can.channel_map import open_channel_map
from cablesense_online.can.emulator import BusSink, Emulator, FrameSink, RecordingPlayer
from cablesense_online.can.slcan import SlcanPort
from cablesense_ros.node_process import (
    ARM,
    BITRATE,
    CHANNEL_MAP,
    DiagnosticsPublisher,
    NodeParameter,
    ParameterError,
    RefusalLog,
    declare_parameters,
    overridable,
    parameter_values,
    qos_profile,
    run_node,
)
from cablesense_sim.arm import open_arm

SLCAN_PORT: Final = "slcan_port"
"""The interface that is none of python-can's: a pseudo-terminal that poses as an adapter."""

CAN_EMULATOR_PARAMETERS: Final = (
    ARM,
    CHANNEL_MAP,
    BITRATE,
    NodeParameter(
        "interface",
        SLCAN_PORT,
        "slcan_port poses as a serial adapter on a pseudo-terminal; else python-can's name of an "
        "interface, such as socketcan.",
    ),
    NodeParameter(
        "channel",
        "/tmp/cablesense_can",
        "With slcan_port, the path of a link to the terminal; else the interface's channel, such "
        "as vcan0.",
    ),
    NodeParameter(
        "recording",
        "",
        "Recording to play, a .csv or .mcap file; empty: what comes on simulated_tensions.",
    ),
    NodeParameter("loop", False, "Play the recording again when it has ended."),
    NodeParameter(
        "fault",
        "",
        "What goes wrong, such as 'missing_channel cable_5' or bus_off; empty for nothing. May "
        "change at any time.",
    ),
)


LISTEN_S = 0.01
"""How often frames of others are taken."""

PLAY_S = 0.001
"""How often rows of a recording are looked for: those found together go out in one burst."""


class CanEmulatorNode(Node):
    """Plays one cycle of frames for every sample of tensions."""

    def __init__(self) -> None:
        super().__init__("can_emulator")
        declare_parameters(self, CAN_EMULATOR_PARAMETERS, read_only=False)
        given = parameter_values(self, CAN_EMULATOR_PARAMETERS)
        if given["loop"] and not given["recording"]:
            raise ParameterError("parameter loop has no effect without recording; leave it false")
        if given["bitrate_bit_s"] and given["interface"] == SLCAN_PORT:
            raise ParameterError(
                "parameter bitrate_bit_s has no effect on slcan_port: who opens the adapter sets "
                "it; leave it 0"
            )
        self._arm = open_arm(given["arm"])
        channel_map, database = open_channel_map(given["map"])
        channel_map = channel_map.arranged(self._arm.cable_names)
        self._order = NamedOrder(self._arm.cable_names, "cables")
        self._refuse = RefusalLog(self, "sample refused, no frames are sent for it")
        self._reported_cycles = 0
        self._player: RecordingPlayer | None = None
        self._commands_out: Publisher | None = None
        if given["recording"]:
            # imported only here, as a robot may lack what it needs
            from cablesense_gap.recordings.checks import read_recording

            rows = read_recording(given["recording"], self._arm)
            self._player = RecordingPlayer(
                rows.time_s, rows.tensions_n, rows.command_rad, given["loop"]
            )
            self._commands_out = self.create_publisher(
                JointState, topics.JOINT_COMMANDS, qos_profile(PUBLISHER)
            )
        self._emulator = Emulator(channel_map, database, _sink_opener(given))
        try:
            self._emulator.request(given["fault"])
        except CableSenseError:
            self._emulator.close()
            raise
        if self._player is None:
            take = self._refuse.guarded(
                topics.SIMULATED_TENSIONS,
                lambda m: self._emulator.cycle(self._order.pick(m.name, m.effort, "effort")),
            )
            self.create_subscription(
                JointState, topics.SIMULATED_TENSIONS, take, **overridable(SENSOR)
            )
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._on_parameters)
        DiagnosticsPublisher(self, self._statuses, lambda: self._arm.identity)
        self.create_timer(LISTEN_S, self._emulator.listen)
        if self._player is not None:
            self.create_timer(PLAY_S, self._play_recording)
        self.get_logger().info(
            f"arm {self._arm.identity}: map {channel_map.name} as frames on {given['interface']} "
            f"{given['channel']}"
        )

    def destroy_node(self) -> None:
        """Pull the interface first, so that its link goes too."""
        self._emulator.close()
        super().destroy_node()

    def _play_recording(self) -> None:
        if self._player is None:
            return
        for tensions_n, command_rad in self._player.due(time.monotonic()):
            if command_rad is not None and self._commands_out is not None:
                message = JointState(name=list(self._arm.joint_names))
                message.header.stamp = self.get_clock().now().to_msg()
                put_joint_angles(message, command_rad)
                self._commands_out.publish(message)
            self._refuse.guarded("recording", self._emulator.cycle)(tensions_n.tolist())

    def _check_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            for parameter in parameters:
                if parameter.name == "fault":
                    self._emulator.check(parameter.value)
        except CableSenseError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _on_parameters(self, parameters: list[Parameter]) -> None:
        for parameter in parameters:
            if parameter.name != "fault":
                continue
            try:
                self._emulator.request(parameter.value)
            except CableSenseError as error:  # what was pulled cannot be plugged in again
                self.get_logger().error(f"fault {parameter.value!r}: {error}")
                continue
            self.get_logger().info(f"fault: {self._emulator.fault or 'none'}")

    def _statuses(self) -> list[Status]:
        cycles = self._emulator.cycles
        recent, self._reported_cycles = cycles - self._reported_cycles, cycles
        level, message = Level.OK, "sending"
        if self._emulator.fault:
            level, message = Level.WARN, f"faulty on request: {self._emulator.fault}"
        elif self._player is not None and self._player.ended:
            message = "the recording has ended"
        elif not recent:
            level, message = Level.STALE, f"nothing on {topics.SIMULATED_TENSIONS}"
        values = {
            "cycles": str(cycles),
            "frames dropped": str(self._emulator.dropped),
            "samples refused": str(self._refuse.count),
            "fault": self._emulator.fault or "none",
        }
        return [Status("frames", level, message, values)]


def _sink_opener(given: dict[str, Any]) -> Callable[[], FrameSink]:
    if given["interface"] == SLCAN_PORT:
        return lambda: SlcanPort(given["channel"])
    interface = CanInterface(given["interface"], given["channel"], given["bitrate_bit_s"])
    return lambda: BusSink(interface.open())


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; the process's exit code."""
    return run_node(CanEmulatorNode, args)


if __name__ == "__main__":
    sys.exit(main())
