"""The `sim` node: the arm at real time with its effects, as if it were the real one on the bus."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from cablesense_base.errors import CableSenseError
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
from cablesense_msgs_py.qos import COMMAND, LATCHED, PUBLISHER, Qos
from cablesense_msgs_py.topics import Frames
from cablesense_online.simulated_arm import LONGEST_LAG_S, SimulatedArm
from cablesense_ros.node_process import (
    WARN_EVERY_S,
    DiagnosticsPublisher,
    NodeParameter,
    ParameterError,
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
    NodeParameter("arm", "cdsm", "Arm file: the name of a bundled one, or a path."),
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
        "frame_prefix",
        "",
        "Goes before every frame name, as robot_state_publisher's parameter does.",
    ),
    NodeParameter(
        "load_timeout_s",
        0.0,
        "A load lapses this many seconds after its last message; 0: it holds until changed.",
        0.0,
        3600.0,
    ),
    NodeParameter(
        "joint_speed_deg_s",
        20.0,
        "Peak speed at which joints approach a command, deg/s; give the estimator the same.",
        0.1,
        360.0,
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
        self._frames = Frames(self._arm.segment_count, given["frame_prefix"])
        self._joint_order = NamedOrder(self._arm.joint_names, "joints")
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
        self._refusals = 0
        self._tensions = JointState(name=list(self._arm.cable_names))
        self._joint_states = JointState(name=list(self._arm.joint_names))
        self._tensions.header.frame_id = self._joint_states.header.frame_id = self._frames.base
        self._tick_count = 0
        self._ticks_per_joint_state = max(1, math.ceil(self._rate_hz / JOINT_STATES_HZ))
        self._tensions_out = self._make_publisher(JointState, topics.CABLE_TENSIONS, PUBLISHER)
        self._joint_states_out = self._make_publisher(JointState, topics.JOINT_STATES, PUBLISHER)
        description_out = self._make_publisher(String, topics.ROBOT_DESCRIPTION, LATCHED)
        description_out.publish(String(data=urdf_xml(self._arm)))
        self._subscribe(JointState, topics.JOINT_COMMANDS, self._on_command)
        self._subscribe(WrenchStamped, topics.APPLIED_WRENCH, self._on_load)
        DiagnosticsPublisher(self, self._statuses, lambda: self._arm.identity)
        self.create_timer(1.0 / self._rate_hz, self._tick)
        self.get_logger().info(
            f"arm {self._arm.identity}: {self._arm.cable_count} cables at {self._rate_hz:g} Hz"
        )

    def _make_publisher(self, kind: type, topic: str, qos: Qos) -> Publisher:
        return self.create_publisher(kind, topic, **overridable(qos))

    def _subscribe(self, kind: type, topic: str, callback: Callable[[Any], None]) -> Subscription:
        return self.create_subscription(kind, topic, callback, **overridable(COMMAND))

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

    def _on_command(self, message: JointState) -> None:
        try:
            self._simulated.go_to(joint_command_rad(message, self._joint_order))
        except CableSenseError as error:
            self._refuse(topics.JOINT_COMMANDS, error)

    def _on_load(self, message: WrenchStamped) -> None:
        try:
            self._simulated.push(read_load(message, self._frames), time.monotonic())
        except CableSenseError as error:
            self._refuse(topics.APPLIED_WRENCH, error)

    def _refuse(self, topic: str, error: CableSenseError) -> None:
        self._refusals += 1
        self.get_logger().warning(
            f"{topic}: message refused, commands and loads stay as they were: {error}",
            throttle_duration_sec=WARN_EVERY_S,
        )

    def _statuses(self) -> list[Status]:
        factor = self._simulated.real_time_factor(time.monotonic())
        level, message = Level.OK, "at real time"
        if factor < _SLOWEST_FACTOR:
            level, message = Level.WARN, f"at {factor:.2f} of real time: the machine is too busy"
        if self._simulated.resets:
            level, message = (
                Level.ERROR,
                "the simulation diverged; it was restarted without loads",
            )
        loads = ", ".join(
            f"segment_{segment}: {force:.1f}" for segment, force in self._simulated.loads_n.items()
        )
        values = {
            "real time factor": f"{factor:.3f}",
            "time let go (s)": f"{self._simulated.skipped_s:.3f}",
            "rate (Hz)": f"{self._rate_hz:g}",
            "loads (N)": loads or "none",
            "messages refused": str(self._refusals),
            "resets": str(self._simulated.resets),
            "arm": self._arm.identity,
        }
        return [Status("simulation", level, message, values)]


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; the process's exit code."""
    return run_node(SimNode, args)


if __name__ == "__main__":
    sys.exit(main())
