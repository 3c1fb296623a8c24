"""The `sim` node: the arm at real time with its effects, as if it were the real one on the bus."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from typing import Final

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String

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
from cablesense_msgs_py.qos import COMMAND, LATCHED, PUBLISHER
from cablesense_msgs_py.topics import Frames
from cablesense_online.simulated_arm import LONGEST_LAG_S, SimulatedArm
from cablesense_ros.node_process import (
    ARM,
    FRAME_PREFIX,
    JOINT_SPEED,
    DiagnosticsPublisher,
    NodeParameter,
    ParameterError,
    RefusalLog,
    declare_parameters,
    overridable,
    parameter_values,
    run_node,
)
from cablesense_sim.arm import open_arm
from cablesense_sim.build import entries_of
from cablesense_sim.dynamics import moving_arm
from cablesense_sim.effects.registry import sensings
from cablesense_sim.urdf import urdf_xml

SIM_PARAMETERS: Final = (
    ARM,
    FRAME_PREFIX,
    JOINT_SPEED,
    NodeParameter(
        "rate_hz",
        0.0,
        "Rate of cable_tensions, Hz; 0 takes the sensors' rate from the arm file.",
        0.0,
        1000.0,
    ),
    NodeParameter(
        "noise", True, "Whether readings have the sensors' noise and step; else true tensions."
    ),
    NodeParameter("seed", 0, "Seed of the noise.", 0, 2**31 - 1),
    NodeParameter(
        "load_timeout_s",
        0.0,
        "A load lapses this many seconds after its last message; 0: it holds until changed.",
        0.0,
        3600.0,
    ),
)

TIMESTEP_S = 1e-3
JOINT_STATES_HZ = 100.0
"""`joint_states` come with the tensions, but no faster than this: they are for display."""

_SLOWEST_FACTOR = 0.95
_PERIODS_OF_LAG = 2.0


class SimNode(Node):
    """Publishes what the arm's sensors would read; takes commands and loads."""

    def __init__(self) -> None:
        super().__init__("sim")
        declare_parameters(self, SIM_PARAMETERS, read_only=True)
        given = parameter_values(self, SIM_PARAMETERS)
        self._arm = open_arm(given["arm"])
        frames = Frames(self._arm.segment_count, given["frame_prefix"])
        joints = NamedOrder(self._arm.joint_names, "joints")
        if given["seed"] and not given["noise"]:
            raise ParameterError("parameter seed has no effect without noise; leave it 0")
        self._rng = np.random.default_rng(given["seed"]) if given["noise"] else None
        self._rate_hz = given["rate_hz"] or min(self._arm.sensors.rate_hz, 1000.0)
        self._simulated = SimulatedArm(
            moving_arm(self._arm, TIMESTEP_S),
            TIMESTEP_S,
            math.radians(given["joint_speed_deg_s"]),
            given["load_timeout_s"],
            time.monotonic(),
            sensings=sensings([entries_of(self._arm)]),
            longest_lag_s=max(LONGEST_LAG_S, _PERIODS_OF_LAG / self._rate_hz),
        )
        self._tensions = JointState(name=list(self._arm.cable_names))
        self._joint_states = JointState(name=list(self._arm.joint_names))
        self._tensions.header.frame_id = self._joint_states.header.frame_id = frames.base
        self._tick_count = 0
        self._ticks_per_joint_state = max(1, math.ceil(self._rate_hz / JOINT_STATES_HZ))
        self._tensions_out, self._joint_states_out, description_out = (
            self.create_publisher(kind, topic, **overridable(qos))
            for kind, topic, qos in (
                (JointState, topics.CABLE_TENSIONS, PUBLISHER),
                (JointState, topics.JOINT_STATES, PUBLISHER),
                (String, topics.ROBOT_DESCRIPTION, LATCHED),
            )
        )
        description_out.publish(String(data=urdf_xml(self._arm)))

        def on_command(message: JointState) -> None:
            self._simulated.go_to(joint_command_rad(message, joints))

        def on_load(message: WrenchStamped) -> None:
            self._simulated.push(read_load(message, frames), time.monotonic())

        self._refuse = RefusalLog(self, "message refused, commands and loads stay as they were")
        for kind, topic, handle in (
            (JointState, topics.JOINT_COMMANDS, on_command),
            (WrenchStamped, topics.APPLIED_WRENCH, on_load),
        ):
            take = self._refuse.guarded(topic, handle)
            self.create_subscription(kind, topic, take, **overridable(COMMAND))
        DiagnosticsPublisher(self, self._statuses, lambda: self._arm.identity)
        self.create_timer(1.0 / self._rate_hz, self._tick)
        self.get_logger().info(
            f"arm {self._arm.identity}: {self._arm.cable_count} cables at {self._rate_hz:g} Hz"
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
        factor = self._simulated.pacer.real_time_factor(time.monotonic())
        level, message = Level.OK, "at real time"
        if factor < _SLOWEST_FACTOR:
            level, message = Level.WARN, f"at {factor:.2f} of real time: the machine is too busy"
        if self._simulated.resets:
            level, message = Level.ERROR, "the simulation diverged; it was restarted without loads"
        loads = ", ".join(
            f"segment_{segment}: {force:.1f}" for segment, force in self._simulated.loads_n.items()
        )
        values = {
            "real time factor": f"{factor:.3f}",
            "time let go (s)": f"{self._simulated.pacer.skipped_s:.3f}",
            "rate (Hz)": f"{self._rate_hz:g}",
            "loads (N)": loads or "none",
            "messages refused": str(self._refuse.count),
            "resets": str(self._simulated.resets),
            "arm": self._arm.identity,
        }
        return [Status("simulation", level, message, values)]


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; the process's exit code."""
    return run_node(SimNode, args)


if __name__ == "__main__":
    sys.exit(main())
