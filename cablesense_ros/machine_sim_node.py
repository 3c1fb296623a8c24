"""The `machine_sim` node: a machine that MuJoCo describes, at rest at each reading."""

from __future__ import annotations

import sys
import time
from functools import partial

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState

from cablesense_contact.machine.felt_model import FeltModel
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import (
    Level,
    NamedOrder,
    Status,
    joint_command_rad,
    put_joint_angles,
    put_tensions,
    read_load,
)
from cablesense_msgs_py.qos import COMMAND, PUBLISHER
from cablesense_online.models import frames_of
from cablesense_online.moving_machine import MovingMachine
from cablesense_ros.endpoints import CommandInput, RefusalLog, overridable
from cablesense_ros.node_process import (
    declare_parameters,
    parameter_table,
    publish_diagnostics,
    run_node,
)
from cablesense_sim.machine.machine import open_machine


class MachineSimNode(Node):
    """Publishes what the machine's sensors would read; takes commands and loads on links."""

    def __init__(self) -> None:
        super().__init__("machine_sim")
        settings = declare_parameters(self, parameter_table("machine_sim"))
        machine = open_machine(settings["machine"])
        felt = FeltModel(machine)
        frames = frames_of(felt, settings["frame_prefix"])
        self._rng = np.random.default_rng(settings["seed"]) if settings["noise"] else None
        self._rate_hz = settings["rate_hz"]
        self._simulated = MovingMachine(
            machine, settings["joint_speed_rad_s"], settings["built_seed"]
        )
        self._last_s = time.monotonic()
        self._readings = JointState(name=list(machine.channels.names))
        self._joint_states = JointState(name=list(machine.coordinates.names))
        self._readings.header.frame_id = frames.base
        self._joint_states.header.frame_id = frames.base
        self._readings_out, self._joint_states_out = (
            self.create_publisher(JointState, topic, **overridable(topic, PUBLISHER))
            for topic in (topics.CABLE_TENSIONS, topics.JOINT_STATES)
        )
        order = NamedOrder(machine.command_names, "joints")

        def on_command(message: JointState) -> None:
            target = self._simulated.target
            self._simulated.go_to(joint_command_rad(message, order, target, felt.largest_command))

        def on_load(message: WrenchStamped) -> None:
            self._simulated.push(read_load(message, frames))

        self._refuse = RefusalLog(self, "message refused, commands and loads stay as they were")
        CommandInput(
            self, self._refuse, machine.command_names, lambda: self._simulated.target, on_command
        )
        self._refuse.subscribe(WrenchStamped, topics.APPLIED_WRENCH, COMMAND, on_load)
        publish_diagnostics(self, self._statuses, lambda: machine.identity)
        self.create_timer(1.0 / self._rate_hz, self._tick)
        self.get_logger().info(
            f"machine {machine.identity}: {len(machine.channels.names)} channels at "
            f"{self._rate_hz:g} Hz"
        )

    def _tick(self) -> None:
        now_s = time.monotonic()
        self._simulated.advance(now_s - self._last_s)
        self._last_s = now_s
        stamp = self.get_clock().now().to_msg()
        self._joint_states.header.stamp = stamp
        put_joint_angles(self._joint_states, self._simulated.measured())
        self._joint_states_out.publish(self._joint_states)
        self._readings.header.stamp = stamp
        put_tensions(self._readings, self._simulated.reading(self._rng))
        self._readings_out.publish(self._readings)

    def _statuses(self) -> list[Status]:
        refusals = self._simulated.refusals
        level = Level.WARN if refusals else Level.OK
        message = "the forces are more than it can bear" if refusals else "at rest"
        loads = [
            f"{self._simulated.machine.links.names[number - 1]}: "
            f"{np.linalg.norm(load.force_base_n):.1f}"
            for number, load in self._simulated.loads.items()
        ]
        values = {
            "rate (Hz)": f"{self._rate_hz:g}",
            "loads (N)": ", ".join(loads) or "none",
            "messages refused": str(self._refuse.count),
            "machine": self._simulated.machine.identity,
        }
        return [Status("simulation", level, message, values)]


main = partial(run_node, MachineSimNode)


if __name__ == "__main__":
    sys.exit(main())
