"""The `admittance` node: reads the estimator's wrench and states, publishes joint commands.

    python -m examples.admittance.controller_node --ros-args -p deadband_n:=3.0

Its parameters are the fields of `AdmittanceSettings`, with `arm`, `frame_prefix` and `estimator`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import fields
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState

from cablesense_base import Array, CableSenseError
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import (
    MAX_LOAD_N,
    ForceState,
    NamedOrder,
    Status,
    breath_turn,
    joint_command_rad,
    put_joint_angles,
    read_force_state,
)
from cablesense_msgs_py.qos import COMMAND, PUBLISHER, SENSOR
from cablesense_msgs_py.topics import ContractError, Frames
from cablesense_online.followed_publisher import FollowedPublisher
from cablesense_ros.endpoints import RefusalLog, of_node, qos_profile, steady_timer
from cablesense_ros.node_process import publish_diagnostics, run_node
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import checked_command
from examples.admittance.controller import AdmittanceController
from examples.admittance.law import AdmittanceSettings
from examples.admittance.trust import ContactState

SILENCE_CHECK_S = 0.02
HALVES_KEPT = 64  # wrenches and states that wait for the other with the same stamp


class AdmittanceNode(Node):
    """Moves the arm away from contacts; stopped, the arm holds its last command."""

    def __init__(self) -> None:
        super().__init__("admittance")
        defaults: dict[str, Any] = {f.name: f.default for f in fields(AdmittanceSettings)}
        defaults |= {"arm": "cdsm", "frame_prefix": "", "estimator": "estimator"}
        values = {name: self.declare_parameter(name, of).value for name, of in defaults.items()}
        arm = open_arm(values.pop("arm"))
        self._frames = Frames(arm.segment_count, values.pop("frame_prefix"))
        estimator = values.pop("estimator")
        settings = AdmittanceSettings(**values)
        self._mechanism = mechanism_of(arm)
        self._controller = AdmittanceController(self._mechanism, settings, time.monotonic())
        self._joints = NamedOrder(arm.joint_names, "joints")
        self._command = JointState(name=list(arm.joint_names))
        self._commands_out = self.create_publisher(
            JointState, topics.JOINT_COMMANDS, qos_profile(PUBLISHER)
        )
        self._halves: dict[int, dict[str, Any]] = {}
        self._was_stopped = True
        refuse = RefusalLog(self)
        refuse.subscribe(JointState, topics.JOINT_COMMANDS, COMMAND, self._on_command)
        for kind, topic, handle in (
            (WrenchStamped, topics.WRENCH, self._on_wrench),
            (DiagnosticArray, topics.STATUS, self._on_status),
        ):
            name = of_node(estimator, topic)
            publisher = FollowedPublisher(settings.stale_after_s)  # two estimators: stop
            accept = partial(self._stopping, name, publisher.accept)
            take = partial(self._stopping, name, handle)
            refuse.subscribe(kind, name, SENSOR, take, publisher, accept)
        steady_timer(self, SILENCE_CHECK_S, self._check_silence)
        publish_diagnostics(self, self._statuses, lambda: arm.identity)

    def _stopping(self, topic: str, handle: Callable[..., Any], *given: Any) -> Any:
        """Handle a message; one that is refused stops the controller."""
        try:
            return handle(*given)
        except CableSenseError as error:
            self._controller.watch.refused(f"{topic}: a message was refused: {error}")
            raise

    def _on_wrench(self, message: WrenchStamped) -> None:
        if message.header.frame_id == self._frames.base:  # nothing touches, or nothing is known
            return
        segment = self._frames.segment_number(message.header.frame_id)
        force = message.wrench.force
        force_n = np.array([force.x, force.y, force.z])
        if not np.linalg.norm(force_n) <= MAX_LOAD_N:
            raise ContractError(f"wrench.force is {force_n} N; at most {MAX_LOAD_N:g} N are true")
        stamp = message.header.stamp
        stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
        self._pair(stamp_ns, segment=segment, force_n=force_n)

    def _on_status(self, message: DiagnosticArray) -> None:
        force, stamp_ns = read_force_state(message)
        if force is ForceState.CONTACT:
            self._pair(stamp_ns, force=force)
        else:
            self._estimated(stamp_ns, force=force, segment=0, force_n=np.zeros(3))

    def _pair(self, stamp_ns: int, **half: Any) -> None:
        """Bring a wrench and its state together, whichever comes first."""
        halves = self._halves.pop(stamp_ns, {}) | half
        if len(halves) == 3:
            self._estimated(stamp_ns, **halves)
            return
        self._halves[stamp_ns] = halves
        if len(self._halves) > HALVES_KEPT:
            del self._halves[next(iter(self._halves))]

    def _estimated(self, stamp_ns: int, **estimate: Any) -> None:
        now_ns = self.get_clock().now().nanoseconds
        now_s = time.monotonic()
        times = {"stamp_ns": stamp_ns, "clock_ns": now_ns, "now_s": now_s}
        self._send(self._controller.received(**estimate, **times))

    def _on_command(self, message: JointState) -> None:
        if breath_turn(message) is not None:
            return
        present_rad = self._controller.command_rad
        command_rad = joint_command_rad(message, self._joints, present_rad)
        command_rad = checked_command(self._mechanism, command_rad)
        if self._controller.received_command(command_rad, time.monotonic()):
            self.get_logger().warning("another node commands: that pose is home from now on")

    def _check_silence(self) -> None:
        watch = self._controller.watch
        stopped = watch.update(time.monotonic()) is ContactState.STOPPED
        if stopped != self._was_stopped:
            why = f"stopped: {watch.reason}" if stopped else "estimates are trusted"
            self.get_logger().warning(why)
        self._was_stopped = stopped
        self._send(self._controller.repeated(time.monotonic()))

    def _send(self, command_rad: Array | None) -> None:
        if command_rad is not None:
            self._command.header.stamp = self.get_clock().now().to_msg()
            put_joint_angles(self._command, command_rad)
            self._commands_out.publish(self._command)

    def _statuses(self) -> list[Status]:
        level, message = self._controller.verdict(time.monotonic())
        command_deg = ", ".join(f"{a:.3f}" for a in np.rad2deg(self._controller.command_rad))
        return [Status("control", level, message, {"command (deg)": command_deg})]


main = partial(run_node, AdmittanceNode)


if __name__ == "__main__":
    sys.exit(main())
