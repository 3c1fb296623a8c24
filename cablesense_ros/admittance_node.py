"""The `admittance` node: moves the arm away from contacts that the estimator finds."""

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
from sensor_msgs.msg import JointState

from cablesense_base import Array, CableSenseError
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import (
    ForceState,
    Level,
    NamedOrder,
    Status,
    breath_turn,
    joint_command_rad,
    put_joint_angles,
    read_force_state,
)
from cablesense_msgs_py.qos import COMMAND, PUBLISHER, SENSOR, Qos
from cablesense_msgs_py.topics import Frames
from cablesense_online.admittance.controller import AdmittanceController
from cablesense_online.admittance.estimate_watch import (
    ContactState,
    ForcePairs,
    read_wrench,
)
from cablesense_online.admittance.law import AdmittanceSettings
from cablesense_online.samples import FollowedPublisher
from cablesense_ros.endpoints import WARN_EVERY_S, RefusalLog, of_node, overridable
from cablesense_ros.node_process import ConfiguredNode, run_node, steady_timer
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import checked_command

SILENCE_CHECK_S = 0.02
"""How often silence of the estimator is checked for."""


class AdmittanceNode(ConfiguredNode):
    """Configured: receives and knows what can be known. Active: sends joint commands as well.

    Deactivated, the arm holds the last command.
    """

    def __init__(self) -> None:
        super().__init__("admittance")
        self._refuse = RefusalLog(self)

    def _configure(self, given: dict[str, Any]) -> None:
        arm = open_arm(given["arm"])
        self._mechanism = mechanism_of(arm)
        names = {field.name for field in fields(AdmittanceSettings)}
        settings = AdmittanceSettings(**{name: given[name] for name in names & set(given)})
        self._controller = AdmittanceController(self._mechanism, settings, time.monotonic())
        self._pairs = ForcePairs()
        self._frames = Frames(arm.segment_count, given["frame_prefix"])
        self._joints = NamedOrder(arm.joint_names, "joints")
        self._command = JointState(name=list(arm.joint_names))
        self._commands_out = self.create_publisher(
            JointState, topics.JOINT_COMMANDS, **overridable(PUBLISHER)
        )
        self._entities.callback(self.destroy_publisher, self._commands_out)
        inputs: tuple[tuple[type, str, Qos, Callable[[Any], None]], ...] = (
            (WrenchStamped, topics.WRENCH, SENSOR, self._on_wrench),
            (DiagnosticArray, topics.STATUS, SENSOR, self._on_status),
            # this stops nothing: arm and estimator refuse a command as well
            (JointState, topics.JOINT_COMMANDS, COMMAND, self._on_command),
        )
        for kind, topic, quality, handle in inputs:
            name, publisher, accept = of_node(given["estimator"], topic), None, None
            if quality is SENSOR:
                publisher = FollowedPublisher(settings.stale_after_s)
                accept = partial(self._stopping, name, publisher.accept)
                handle = partial(self._stopping, name, handle)
            subscription = self._refuse.subscribe(kind, name, quality, handle, publisher, accept)
            self._entities.callback(self.destroy_subscription, subscription)
        timer = steady_timer(self, SILENCE_CHECK_S, self._check_silence)
        self._entities.callback(self.destroy_timer, timer)
        self._logged_state = ContactState.STOPPED
        self._identity = arm.identity
        self.get_logger().info(f"arm {arm.identity}: configured")

    def _stopping(self, topic: str, handle: Callable[..., Any], *given: Any) -> Any:
        """Handle a message; one that is refused, as of another estimator, stops the controller."""
        try:
            return handle(*given)
        except CableSenseError as error:
            self._controller.watch.refused(f"{topic}: a message was refused: {error}")
            raise

    def _on_wrench(self, message: WrenchStamped) -> None:
        segment, force_n, stamp_ns = read_wrench(message, self._frames)
        if segment and self._pairs.force(stamp_ns, segment, force_n):
            self._on_force(ForceState.CONTACT, stamp_ns)

    def _on_status(self, message: DiagnosticArray) -> None:
        self._on_force(*read_force_state(message))

    def _on_force(self, force: ForceState, stamp_ns: int) -> None:
        found: tuple[int, Array] | None = (0, np.zeros(3))
        if force is ForceState.CONTACT:
            found = self._pairs.take(stamp_ns)
        if self._active and found is not None:
            now_ns, now_s = self.get_clock().now().nanoseconds, time.monotonic()
            self._send(self._controller.received(force, *found, stamp_ns, now_ns, now_s))

    def _on_command(self, message: JointState) -> None:
        if breath_turn(message) is not None:
            return
        present_rad = self._controller.command_rad
        command = joint_command_rad(message, self._joints, present_rad)
        command = checked_command(self._mechanism, command)
        if self._controller.received_command(command, time.monotonic()):
            self.get_logger().warning(
                "another node commands: that pose is home from now on",
                throttle_duration_sec=WARN_EVERY_S,
            )

    def _check_silence(self) -> None:
        now_s, watch = time.monotonic(), self._controller.watch
        state, before = watch.update(now_s), self._logged_state
        if state is ContactState.STOPPED and before is not ContactState.STOPPED:
            self.get_logger().warning(f"stopped: {watch.reason}; the arm holds its last command")
        elif state is not ContactState.STOPPED and before is ContactState.STOPPED:
            self.get_logger().info("estimates are trusted: contacts are yielded to")
        self._logged_state = state
        if self._active:
            self._send(self._controller.repeated(now_s))

    def _send(self, command_rad: Array | None) -> None:
        if command_rad is not None:
            self._command.header.stamp = self.get_clock().now().to_msg()
            put_joint_angles(self._command, command_rad)
            self._commands_out.publish(self._command)

    def _statuses(self) -> list[Status]:
        if not self._identity:
            return [Status("control", Level.WARN, "not configured: no arm loaded")]
        commanders = self.count_publishers(topics.JOINT_COMMANDS)
        return [self._controller.status(self._active, commanders, time.monotonic())]


main = partial(run_node, AdmittanceNode)


if __name__ == "__main__":
    sys.exit(main())
