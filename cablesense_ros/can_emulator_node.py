"""The `can_emulator` node: a simulated arm as CAN frames, with faults on request."""

from __future__ import annotations

import sys
from functools import partial

import can
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState

from cablesense_base import CableSenseError
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import Level, NamedOrder, Status
from cablesense_msgs_py.qos import SENSOR_QOS
from cablesense_online.can.bus import CanInterface
from cablesense_online.can.channel_map import open_channel_map
from cablesense_online.can.emulator import Emulator, SlcanPort
from cablesense_ros.endpoints import RefusalLog, steady_timer
from cablesense_ros.node_process import (
    ParameterError,
    declare_parameters,
    parameter_table,
    publish_diagnostics,
    run_node,
)
from cablesense_sim.arm import open_arm

SLCAN_PORT = "slcan_port"
"""A pseudo-terminal that poses as an adapter; python-can has no such interface."""

LISTEN_S = 0.01
"""How often frames of others are taken."""


class CanEmulatorNode(Node):
    """Plays one cycle of frames for every sample of tensions."""

    def __init__(self) -> None:
        super().__init__("can_emulator")
        settings = declare_parameters(self, parameter_table("can_emulator"))
        link = settings["channel"]
        bitrate_bit_s = settings["bitrate_bit_s"]
        if bitrate_bit_s and settings["interface"] == SLCAN_PORT:
            raise ParameterError(
                "parameter bitrate_bit_s has no effect on slcan_port: who opens the adapter sets "
                "it; leave it 0"
            )
        arm = open_arm(settings["arm"])
        channel_map, database = open_channel_map(settings["map"])
        channel_map = channel_map.arranged(arm.cable_names)

        def open_bus() -> can.BusABC:
            if settings["interface"] == SLCAN_PORT:
                return SlcanPort(link)
            return CanInterface(settings["interface"], link, bitrate_bit_s).open()

        self._reported_cycles = 0
        self._emulator = Emulator(channel_map, database, open_bus)
        try:
            self._emulator.request(settings["fault"])
        except CableSenseError:
            self._emulator.close()
            raise
        order = NamedOrder(arm.cable_names, "cables")
        self._refuse = RefusalLog(self, "sample refused, no frames are sent for it")
        self._refuse.subscribe(
            JointState,
            topics.SIMULATED_TENSIONS,
            SENSOR_QOS,
            lambda m: self._emulator.cycle(order.pick(m.name, m.effort, "effort")),
        )
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._on_parameters)
        publish_diagnostics(self, self._statuses, lambda: arm.identity)
        steady_timer(self, LISTEN_S, self._emulator.listen)
        self.get_logger().info(
            f"arm {arm.identity}: map {channel_map.name} as frames on "
            f"{settings['interface']} {link}"
        )

    def destroy_node(self) -> None:
        """Pull the interface first, which also removes its link."""
        self._emulator.close()
        super().destroy_node()

    def _check_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            for parameter in parameters:
                if parameter.name == "fault":
                    self._emulator.check_fault(parameter.value)
        except CableSenseError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _on_parameters(self, parameters: list[Parameter]) -> None:
        for parameter in parameters:
            if parameter.name != "fault":
                continue
            try:
                self._emulator.request(parameter.value)
            except CableSenseError as error:  # the interface cannot be opened again
                self.get_logger().error(f"fault {parameter.value!r}: {error}")
            else:
                self.get_logger().info(f"fault: {self._emulator.fault or 'none'}")

    def _statuses(self) -> list[Status]:
        cycles = self._emulator.cycles
        recent = cycles - self._reported_cycles
        self._reported_cycles = cycles
        level = Level.OK
        message = "sending"
        if self._emulator.fault:
            level = Level.WARN
            message = f"faulty on request: {self._emulator.fault}"
        elif not recent:
            level = Level.STALE
            message = f"nothing on {topics.SIMULATED_TENSIONS}"
        values = {
            "cycles": str(cycles),
            "frames dropped": str(self._emulator.dropped),
            "samples refused": str(self._refuse.count),
            "fault": self._emulator.fault or "none",
        }
        return [Status("frames", level, message, values)]


main = partial(run_node, CanEmulatorNode)


if __name__ == "__main__":
    sys.exit(main())
