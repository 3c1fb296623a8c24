"""The `can_emulator` node: a simulated or recorded arm as CAN frames, with faults on request."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState

from cablesense_base import CableSenseError
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import Level, NamedOrder, Status, put_joint_angles
from cablesense_msgs_py.qos import PUBLISHER, SENSOR
from cablesense_online.can.bus import CanInterface
from cablesense_online.can.channel_map import open_channel_map
from cablesense_online.can.emulator import BusSink, Emulator, FrameSink, RecordingPlayer
from cablesense_online.can.slcan import SlcanPort
from cablesense_ros.endpoints import RefusalLog, qos_profile
from cablesense_ros.node_process import publish_diagnostics, run_node, steady_timer
from cablesense_ros.parameters import ParameterError, declare_parameters, parameter_table
from cablesense_sim.arm import Arm, open_arm

SLCAN_PORT = "slcan_port"
"""The interface that is none of python-can's: a pseudo-terminal that poses as an adapter."""

LISTEN_S = 0.01
"""How often frames of others are taken."""

PLAY_S = 0.001
"""How often rows of a recording are looked for: those found together go out in one burst."""


class CanEmulatorNode(Node):
    """Plays one cycle of frames for every sample of tensions."""

    def __init__(self) -> None:
        super().__init__("can_emulator")
        given = declare_parameters(self, parameter_table("can_emulator"))
        if given["loop"] and not given["recording"]:
            raise ParameterError("parameter loop has no effect without recording; leave it false")
        if given["bitrate_bit_s"] and given["interface"] == SLCAN_PORT:
            raise ParameterError(
                "parameter bitrate_bit_s has no effect on slcan_port: who opens the adapter sets "
                "it; leave it 0"
            )
        arm = open_arm(given["arm"])
        channel_map, database = open_channel_map(given["map"])
        channel_map = channel_map.arranged(arm.cable_names)
        order = NamedOrder(arm.cable_names, "cables")
        self._refuse = RefusalLog(self, "sample refused, no frames are sent for it")
        self._reported_cycles = 0
        self._player = _player(given, arm) if given["recording"] else None
        self._emulator = Emulator(channel_map, database, _sink_opener(given))
        try:
            self._emulator.request(given["fault"])
        except CableSenseError:
            self._emulator.close()
            raise
        if self._player is None:
            self._refuse.subscribe(
                JointState,
                topics.SIMULATED_TENSIONS,
                SENSOR,
                lambda m: self._emulator.cycle(order.pick(m.name, m.effort, "effort")),
            )
        else:
            self._command = JointState(name=list(arm.joint_names))
            self._commands_out = self.create_publisher(
                JointState, topics.JOINT_COMMANDS, qos_profile(PUBLISHER)
            )
            self.create_timer(PLAY_S, partial(self._play_due, self._player))
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._on_parameters)
        publish_diagnostics(self, self._statuses, lambda: arm.identity)
        steady_timer(self, LISTEN_S, self._emulator.listen)
        self.get_logger().info(
            f"arm {arm.identity}: map {channel_map.name} as frames on {given['interface']} "
            f"{given['channel']}"
        )

    def destroy_node(self) -> None:
        """Pull the interface first, so that its link goes too."""
        self._emulator.close()
        super().destroy_node()

    def _play_due(self, player: RecordingPlayer) -> None:
        for tensions_n, command_rad in player.due(time.monotonic()):
            if command_rad is not None:
                self._command.header.stamp = self.get_clock().now().to_msg()
                put_joint_angles(self._command, command_rad)
                self._commands_out.publish(self._command)
            self._refuse.guarded("recording", self._emulator.cycle)(tensions_n.tolist())

    def _check_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            for parameter in parameters:
                if parameter.name == "fault":
                    self._emulator.amplifier.requested(parameter.value)
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
            else:
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


def _player(given: dict[str, Any], arm: Arm) -> RecordingPlayer:
    # imported only here, as a robot may lack what it needs
    from cablesense_gap.recordings.checks import read_recording

    rows = read_recording(given["recording"], arm)
    return RecordingPlayer(rows.time_s, rows.tensions_n, rows.command_rad, given["loop"])


def _sink_opener(given: dict[str, Any]) -> Callable[[], FrameSink]:
    if given["interface"] == SLCAN_PORT:
        return lambda: SlcanPort(given["channel"])
    interface = CanInterface(given["interface"], given["channel"], given["bitrate_bit_s"])
    return lambda: BusSink(interface.open())


main = partial(run_node, CanEmulatorNode)


if __name__ == "__main__":
    sys.exit(main())
