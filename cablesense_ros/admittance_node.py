"""The `admittance` node: moves the arm away from contacts that the estimator finds."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from cablesense_msgs_py import topics
from cablesense_msgs_py.diagnostics import Level, Status
from cablesense_msgs_py.errors import CableSenseError
from cablesense_msgs_py.frames import Frames
from cablesense_msgs_py.joint_state import joint_command_rad, put_joint_angles
from cablesense_msgs_py.named_values import NamedOrder
from cablesense_msgs_py.qos import COMMAND, PUBLISHER
from cablesense_ros.admittance.controller import AdmittanceController
from cablesense_ros.admittance.estimate_watch import Sight
from cablesense_ros.admittance.estimator_messages import (
    check_probabilities,
    input_is_stale,
    read_wrench,
)
from cablesense_ros.admittance.report import control_status
from cablesense_ros.admittance_parameters import ADMITTANCE_PARAMETERS, controller_settings
from cablesense_ros.configured_node import ConfiguredNode, run_configured_node
from cablesense_ros.contract_inputs import of_node
from cablesense_ros.diagnostics_publisher import DiagnosticsPublisher
from cablesense_ros.node_parameters import declare_parameters, parameter_values
from cablesense_ros.qos_profiles import overridable, qos_profile
from cablesense_ros.throttled_log import ThrottledLog
from cablesense_sim.arm import Arm
from cablesense_sim.arm_files import open_arm
from cablesense_sim.command import checked_command
from cablesense_sim.mechanism import Mechanism

LOOK_S = 0.02
"""How often silence of the estimator is looked for."""

Array = np.ndarray


class AdmittanceNode(ConfiguredNode):
    """Configured: listens and knows what can be known. Active: sends joint commands as well."""

    def __init__(self) -> None:
        super().__init__("admittance")
        declare_parameters(self, ADMITTANCE_PARAMETERS, read_only=False)
        self._warn = ThrottledLog(self.get_logger().warning, time.monotonic)
        self._arm: Arm | None = None
        self._mechanism: Mechanism | None = None
        self._controller: AdmittanceController | None = None
        self._frames = Frames(1)
        self._joint_order = NamedOrder((), "joints")
        self._estimator = ""
        self._command = JointState()
        self._commands_out: Publisher | None = None
        self._inputs: list[Subscription] = []
        self._timer: Timer | None = None
        self._active = False
        self._logged_sight = Sight.STOPPED
        DiagnosticsPublisher(self, self._statuses, lambda: self._arm.identity if self._arm else "")

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Commands may be sent."""
        self._active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Send no more; the arm holds the last command."""
        self._active = False
        return super().on_deactivate(state)

    def _configure(self) -> None:
        given = parameter_values(self, ADMITTANCE_PARAMETERS)
        arm = open_arm(given["arm"])
        self._arm, self._mechanism = arm, Mechanism.from_arm(arm)
        self._frames = Frames(arm.segment_count, given["frame_prefix"])
        self._joint_order = NamedOrder(arm.joint_names, "joints")
        self._estimator = given["estimator"]
        self._controller = AdmittanceController(
            self._mechanism, controller_settings(given), time.monotonic()
        )
        self._command = JointState(name=list(arm.joint_names))
        self._commands_out = self.create_publisher(
            JointState,
            topics.JOINT_COMMANDS,
            qos_profile(PUBLISHER),
            qos_overriding_options=overridable(),
        )
        self._inputs = [
            self.create_subscription(
                kind, topic, handle, qos_profile(COMMAND), qos_overriding_options=overridable()
            )
            for kind, topic, handle in (
                (WrenchStamped, of_node(self._estimator, topics.WRENCH), self._on_wrench),
                (
                    Float64MultiArray,
                    of_node(self._estimator, topics.CONTACT_PROBABILITIES),
                    self._on_probabilities,
                ),
                (JointState, topics.JOINT_COMMANDS, self._on_command),
                (DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics),
            )
        ]
        self._timer = self.create_timer(LOOK_S, self._look)
        self._logged_sight = Sight.STOPPED
        self.get_logger().info(f"arm {arm.identity}: configured")

    def _release(self) -> None:
        self._active = False
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        if self._timer is not None:
            self.destroy_timer(self._timer)
        if self._commands_out is not None:
            self.destroy_publisher(self._commands_out)
        self._inputs, self._timer, self._commands_out = [], None, None
        self._controller, self._arm, self._mechanism = None, None, None

    def _on_wrench(self, message: WrenchStamped) -> None:
        if self._controller is None:
            return
        try:
            felt = read_wrench(message, self._frames)
        except CableSenseError as error:
            self._controller.watch.refused(f"a wrench was refused: {error}")
            self._warn("wrench", f"{self._estimator}/wrench: message refused: {error}")
            return
        if not self._active:
            return
        command = self._controller.heard_wrench(
            felt.segment,
            felt.force_n,
            felt.stamp_ns,
            self.get_clock().now().nanoseconds,
            time.monotonic(),
        )
        if command is not None:
            self._send(command)

    def _on_probabilities(self, message: Float64MultiArray) -> None:
        if self._controller is None or self._arm is None:
            return
        try:
            check_probabilities(message, self._arm.segment_count)
        except CableSenseError as error:
            self._controller.watch.refused(f"probabilities were refused: {error}")
            self._warn("probabilities", f"message refused: {error}")
            return
        self._controller.watch.heard_probabilities(time.monotonic())

    def _on_command(self, message: JointState) -> None:
        if self._controller is None or self._mechanism is None:
            return
        try:
            command = checked_command(
                self._mechanism, joint_command_rad(message, self._joint_order)
            )
        except CableSenseError as error:  # arm and estimator refuse it as well
            self._warn("command", f"{topics.JOINT_COMMANDS}: message refused: {error}")
            return
        if self._controller.heard_command(command, time.monotonic()):
            self._warn("yield", "another node commands: that pose is home from now on")

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        if self._controller is None:
            return
        stale = input_is_stale(message, self._estimator)
        if stale is not None:
            self._controller.watch.heard_of_input(stale, time.monotonic())

    def _look(self) -> None:
        if self._controller is None:
            return
        now_s = time.monotonic()
        sight = self._controller.watch.look(now_s)
        if sight is Sight.STOPPED and self._logged_sight is not Sight.STOPPED:
            self.get_logger().warning(
                f"stopped: {self._controller.watch.reason}; the arm holds its last command"
            )
        elif sight is not Sight.STOPPED and self._logged_sight is Sight.STOPPED:
            self.get_logger().info("estimates are trusted: contacts are yielded to")
        self._logged_sight = sight
        if self._active:
            command = self._controller.repeated(now_s)
            if command is not None:
                self._send(command)

    def _send(self, command_rad: Array) -> None:
        if self._commands_out is not None:
            self._command.header.stamp = self.get_clock().now().to_msg()
            put_joint_angles(self._command, command_rad)
            self._commands_out.publish(self._command)

    def _statuses(self) -> list[Status]:
        if self._controller is None:
            return [Status("control", Level.WARN, "not configured: no arm loaded")]
        commanders = self.count_publishers(topics.JOINT_COMMANDS)
        return [control_status(self._controller, self._active, commanders, time.monotonic())]


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; the process's exit code."""
    return run_configured_node(AdmittanceNode, args)


if __name__ == "__main__":
    sys.exit(main())
