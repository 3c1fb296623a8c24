"""The `sim` node: the arm at real time with its effects, as if it were the real one on the bus."""

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

from cablesense_base import Array
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import (
    Level,
    Load,
    NamedOrder,
    Status,
    cable_offsets_m,
    joint_command_rad,
    put_joint_angles,
    put_tensions,
    read_load,
)
from cablesense_msgs_py.qos import COMMAND, LATCHED, PUBLISHER
from cablesense_msgs_py.topics import Frames
from cablesense_online.simulated_arm import LONGEST_LAG_S, SimulatedArm
from cablesense_ros.endpoints import CommandInput, RefusalLog, overridable, qos_profile
from cablesense_ros.node_process import (
    ParameterError,
    declare_parameters,
    parameter_table,
    publish_diagnostics,
    run_node,
)
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.built_arm import as_described, built_arm
from cablesense_sim.dynamics import moving_arm
from cablesense_sim.effects.registry import sensings
from cablesense_sim.loads import contact_of_wrench
from cablesense_sim.touch import touched_places
from cablesense_sim.urdf import urdf_xml

TIMESTEP_S = 1e-3
"""Of the simulated dynamics."""
JOINT_STATES_HZ = 100.0
"""`joint_states` come with the tensions, but no faster than this: they are for display."""

_SLOWEST_FACTOR = 0.95
"""Of real time, below which the machine is too busy."""
_PERIODS_OF_LAG = 2.0
"""Periods of the sensors by which the simulation may lag before it gives up catching up."""


class SimNode(Node):
    """Publishes what the arm's sensors would read; takes commands and loads."""

    def __init__(self) -> None:
        super().__init__("sim")
        settings = declare_parameters(self, parameter_table("sim"))
        if settings["seed"] and not settings["noise"]:
            raise ParameterError("parameter seed has no effect without noise; leave it 0")
        self._arm = open_arm(settings["arm"])
        arm = self._arm
        frames = Frames(arm.segment_count, settings["frame_prefix"])
        joints = NamedOrder(arm.joint_names, "joints")
        cables = NamedOrder(arm.cable_names, "cables")
        self._rng = np.random.default_rng(settings["seed"]) if settings["noise"] else None
        self._rate_hz = settings["rate_hz"] or min(arm.sensors.rate_hz, 1000.0)
        seed = settings["built_seed"]
        self._built_by = "its file" if seed < 0 else f"its tolerances, seed {seed}"
        built = as_described(arm) if seed < 0 else built_arm(arm, seed)
        self._simulated = SimulatedArm(
            moving_arm(arm, TIMESTEP_S, built),
            TIMESTEP_S,
            settings["joint_speed_rad_s"],
            settings["load_timeout_s"],
            time.monotonic(),
            sensings=sensings([built.entries]),
            longest_lag_s=max(LONGEST_LAG_S, _PERIODS_OF_LAG / self._rate_hz),
        )
        self._tensions = JointState(name=list(arm.cable_names))
        self._joint_states = JointState(name=list(arm.joint_names))
        self._tensions.header.frame_id = frames.base
        self._joint_states.header.frame_id = self._tensions.header.frame_id
        self._tick_count = 0
        self._ticks_per_joint_state = max(1, math.ceil(self._rate_hz / JOINT_STATES_HZ))
        self._tensions_out, self._joint_states_out = (
            self.create_publisher(JointState, topic, **overridable(topic, PUBLISHER))
            for topic in (topics.CABLE_TENSIONS, topics.JOINT_STATES)
        )
        if settings["description"]:
            described = self.create_publisher(
                String, topics.ROBOT_DESCRIPTION, qos_profile(LATCHED)
            )
            described.publish(String(data=urdf_xml(arm)))

        def on_command(message: JointState) -> None:
            present_rad = self._simulated.target_rad
            self._simulated.go_to(joint_command_rad(message, joints, present_rad))

        def on_offsets(message: JointState) -> None:
            self._simulated.offset(cable_offsets_m(message, cables))

        mechanism = mechanism_of(arm)
        reach_m = touched_places(arm).touched_m

        def contact_of(force_n: Array, torque_n_m: Array) -> tuple[int, float]:
            pose = self._simulated.joint_angles_rad
            return contact_of_wrench(mechanism, pose, reach_m, force_n, torque_n_m)

        def on_load(message: WrenchStamped) -> None:
            load = read_load(message, frames, contact_of)
            self._simulated.push(load, time.monotonic())

        self._refuse = RefusalLog(
            self, "message refused, commands, offsets and loads stay as they were"
        )
        CommandInput(
            self, self._refuse, arm.joint_names, lambda: self._simulated.target_rad, on_command
        )
        self._refuse.subscribe(JointState, topics.CABLE_OFFSETS, COMMAND, on_offsets)
        self._refuse.subscribe(WrenchStamped, topics.APPLIED_WRENCH, COMMAND, on_load)
        publish_diagnostics(self, self._statuses, lambda: arm.identity)
        self.create_timer(1.0 / self._rate_hz, self._tick)
        self.get_logger().info(
            f"arm {arm.identity}, built by {self._built_by}: {arm.cable_count} cables at "
            f"{self._rate_hz:g} Hz"
        )

    def _tick(self) -> None:
        self._simulated.advance_to(time.monotonic())
        stamp = self.get_clock().now().to_msg()
        self._tensions.header.stamp = stamp
        put_tensions(self._tensions, self._simulated.reading_n(self._arm.sensors, self._rng))
        self._tensions_out.publish(self._tensions)
        if self._tick_count % self._ticks_per_joint_state == 0:
            self._joint_states.header.stamp = stamp
            put_joint_angles(self._joint_states, self._simulated.joint_angles_rad)
            self._joint_states_out.publish(self._joint_states)
        self._tick_count += 1

    def _statuses(self) -> list[Status]:
        simulated = self._simulated
        factor = simulated.pacer.real_time_factor(time.monotonic())
        level = Level.OK
        message = "at real time"
        if factor < _SLOWEST_FACTOR:
            level = Level.WARN
            message = f"at {factor:.2f} of real time: the machine is too busy"
        if simulated.resets:
            level = Level.ERROR
            message = "the simulation diverged; it was restarted without loads"
        loads = map(_shown, simulated.loads)
        values = {
            "real time factor": f"{factor:.3f}",
            "time skipped (s)": f"{simulated.pacer.skipped_s:.3f}",
            "rate (Hz)": f"{self._rate_hz:g}",
            "loads (N)": ", ".join(loads) or "none",
            "messages refused": str(self._refuse.count),
            "resets": str(simulated.resets),
            "arm": self._arm.identity,
            "built by": self._built_by,
        }
        return [Status("simulation", level, message, values)]


def _shown(load: Load) -> str:
    place = "" if load.contact_m is None else f" at {load.contact_m:.3f} m"
    return f"segment_{load.segment}: {np.linalg.norm(load.force_base_n):.1f}{place}"


main = partial(run_node, SimNode)


if __name__ == "__main__":
    sys.exit(main())
