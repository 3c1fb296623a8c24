"""The `sim` node: a machine at real time, as if it were the real one on the bus."""

from __future__ import annotations

import math
import sys
import time
from functools import partial

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import (
    Load,
    NamedOrder,
    Status,
    cable_offsets_m,
    joint_command_rad,
    put_joint_angles,
    put_tensions,
)
from cablesense_msgs_py.qos import COMMAND_QOS, LATCHED_QOS, PUBLISHER_QOS
from cablesense_online.opened_simulation import open_simulation
from cablesense_online.simulation import SimulationSettings
from cablesense_ros.endpoints import CommandInput, RefusalLog, overridable, qos_profile
from cablesense_ros.node_process import (
    ParameterError,
    declare_parameters,
    parameter_table,
    publish_diagnostics,
    run_node,
)


class SimNode(Node):
    """Publishes what the machine's sensors would read; takes commands and loads."""

    def __init__(self) -> None:
        super().__init__("sim")
        given = declare_parameters(self, parameter_table("sim"))
        if given["seed"] and not given["noise"]:
            raise ParameterError("parameter seed has no effect without noise; leave it 0")
        settings = SimulationSettings(
            rate_hz=given["rate_hz"],
            joint_speed_rad_s=given["joint_speed_rad_s"],
            load_timeout_s=given["load_timeout_s"],
            built_seed=given["built_seed"],
        )
        simulated = open_simulation(given["arm"], settings, time.monotonic())
        self._simulated = simulated
        self._built_by = settings.built_by
        self._rng = np.random.default_rng(given["seed"]) if given["noise"] else None
        self._frames = simulated.frames(given["frame_prefix"])
        self._commands = NamedOrder(simulated.command_names, "joints")
        self._channels = NamedOrder(simulated.channel_names, "cables")
        self._readings = JointState(name=list(simulated.channel_names))
        self._joint_states = JointState(name=list(simulated.joint_names))
        self._readings.header.frame_id = self._frames.base
        self._joint_states.header.frame_id = self._frames.base
        self._tick_count = 0
        ticks = simulated.rate_hz / simulated.joint_states_hz
        self._ticks_per_joint_state = max(1, math.ceil(ticks))
        self._readings_out, self._joint_states_out = (
            self.create_publisher(JointState, topic, **overridable(topic, PUBLISHER_QOS))
            for topic in (topics.CABLE_TENSIONS, topics.JOINT_STATES)
        )
        if given["description"] and simulated.urdf is not None:
            described = self.create_publisher(
                String, topics.ROBOT_DESCRIPTION, qos_profile(LATCHED_QOS)
            )
            described.publish(String(data=simulated.urdf))
        self._refuse = RefusalLog(
            self, "message refused, commands, offsets and loads stay as they were"
        )
        CommandInput(
            self, self._refuse, simulated.command_names, lambda: simulated.target, self._on_command
        )
        self._refuse.subscribe(JointState, topics.CABLE_OFFSETS, COMMAND_QOS, self._on_offsets)
        self._refuse.subscribe(WrenchStamped, topics.APPLIED_WRENCH, COMMAND_QOS, self._on_load)
        publish_diagnostics(self, self._statuses, lambda: simulated.identity)
        self.create_timer(1.0 / simulated.rate_hz, self._tick)
        self.get_logger().info(
            f"{simulated.identity}, built by {self._built_by}: "
            f"{len(simulated.channel_names)} channels at {simulated.rate_hz:g} Hz"
        )

    def _on_command(self, message: JointState) -> None:
        simulated = self._simulated
        command = joint_command_rad(
            message, self._commands, simulated.target, simulated.largest_command
        )
        simulated.go_to(command)

    def _on_offsets(self, message: JointState) -> None:
        self._simulated.offset(cable_offsets_m(message, self._channels))

    def _on_load(self, message: WrenchStamped) -> None:
        load = self._simulated.read_load(message, self._frames)
        self._simulated.push(load, time.monotonic())

    def _tick(self) -> None:
        self._simulated.advance_to(time.monotonic())
        stamp = self.get_clock().now().to_msg()
        if self._tick_count % self._ticks_per_joint_state == 0:
            self._joint_states.header.stamp = stamp
            put_joint_angles(self._joint_states, self._simulated.joint_positions)
            self._joint_states_out.publish(self._joint_states)
        self._readings.header.stamp = stamp
        put_tensions(self._readings, self._simulated.reading(self._rng))
        self._readings_out.publish(self._readings)
        self._tick_count += 1

    def _statuses(self) -> list[Status]:
        health = self._simulated.health(time.monotonic())
        loads = map(self._load_text, self._simulated.loads)
        values = {
            **health.values,
            "rate (Hz)": f"{self._simulated.rate_hz:g}",
            "loads (N)": ", ".join(loads) or "none",
            "messages refused": str(self._refuse.count),
            "arm": self._simulated.identity,
            "built by": self._built_by,
        }
        return [Status("simulation", health.level, health.message, values)]

    def _load_text(self, load: Load) -> str:
        place = "" if load.contact_m is None else f" at {load.contact_m:.3f} m"
        size_n = np.linalg.norm(load.force_base_n)
        return f"{self._frames.segment(load.segment)}: {size_n:.1f}{place}"


main = partial(run_node, SimNode)


if __name__ == "__main__":
    sys.exit(main())
