"""The `admittance` node: moves the arm away from contacts that the estimator finds."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from cablesense_base.errors import CableSenseError
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import (
    Level,
    NamedOrder,
    Status,
    joint_command_rad,
    put_joint_angles,
)
from cablesense_msgs_py.qos import COMMAND, PUBLISHER
from cablesense_msgs_py.topics import Frames
from cablesense_online.admittance.controller import (
    AdmittanceController,
    ControllerSettings,
    control_status,
)
from cablesense_online.admittance.estimate_watch import (
    ContactState,
    WatchSettings,
    check_probabilities,
    input_is_stale,
    read_wrench,
)
from cablesense_online.admittance.law import AdmittanceSettings
from cablesense_ros.node_process import (
    WARN_EVERY_S,
    ConfiguredNode,
    DiagnosticsPublisher,
    NodeParameter,
    declare_parameters,
    of_node,
    overridable,
    parameter_values,
    run_configured_node,
)
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.dynamics import checked_command
from cablesense_sim.mechanism import Mechanism

ADMITTANCE_PARAMETERS: Final = (
    NodeParameter("arm", "cdsm", "Arm file: the name of a bundled one, or a path."),
    NodeParameter(
        "autostart", True, "Configure and activate at start, without a lifecycle manager."
    ),
    NodeParameter(
        "estimator", "estimator", "Name of the estimator node whose estimates are used."
    ),
    NodeParameter("frame_prefix", "", "Goes before every frame name, as in the other nodes."),
    NodeParameter(
        "worst_stiffness_n_m",
        20_000.0,
        "The stiffest contact that is expected, N/m; the loop is stable up to twice this.",
        10.0,
        1e8,
    ),
    NodeParameter("deadband_n", 2.0, "Contact forces up to this one cause no move, N.", 0.1, 1e3),
    NodeParameter(
        "damping_n_m_s_rad", 5.0, "Damping D of every joint axis, N·m·s/rad.", 0.01, 1e4
    ),
    NodeParameter(
        "return_stiffness_n_m_rad",
        1.0,
        "Stiffness K of every joint axis towards home, N·m/rad; 0 stays where it is.",
        0.0,
        1e3,
    ),
    NodeParameter(
        "touch_n",
        4.0,
        "Most force, N, with which a step towards home may meet an unseen contact of the worst "
        "stiffness.",
        0.1,
        1e3,
    ),
    NodeParameter(
        "step_limit_deg", 1.0, "No joint turns farther in one step, degrees.", 0.01, 10.0
    ),
    NodeParameter(
        "speed_limit_deg_s",
        5.0,
        "Nor, on the average from one step to the next, faster, degrees per second.",
        0.01,
        90.0,
    ),
    NodeParameter(
        "joint_limit_deg",
        10.0,
        "Largest bend of a joint that is commanded, degrees; guide plates end it earlier.",
        0.1,
        60.0,
    ),
    NodeParameter("measure_s", 0.1, "Estimates are averaged over this time, s.", 0.01, 5.0),
    NodeParameter(
        "stale_after_s", 0.2, "Without a fresh wrench for this long, s, it stops.", 0.05, 5.0
    ),
    NodeParameter(
        "resume_after_s",
        1.0,
        "Estimates must come for this long, s, before they are trusted again.",
        0.0,
        60.0,
    ),
    NodeParameter(
        "yield_s",
        2.0,
        "After a command of another node none is sent for this long, s.",
        0.0,
        3600.0,
    ),
    NodeParameter(
        "await_command",
        False,
        "Send nothing before a command was received; else the arm is assumed to be straight.",
    ),
    NodeParameter(
        "joint_speed_deg_s",
        20.0,
        "Peak speed at which joints approach a command, deg/s; as the estimator's.",
        0.1,
        360.0,
    ),
    NodeParameter(
        "settle_s",
        0.5,
        "How long the estimator gives no estimate after a move, s; as its own.",
        0.0,
        60.0,
    ),
)


def controller_settings(values: Mapping[str, Any]) -> ControllerSettings:
    """The settings of the parameters' values."""
    law = AdmittanceSettings(
        damping_n_m_s_rad=values["damping_n_m_s_rad"],
        return_stiffness_n_m_rad=values["return_stiffness_n_m_rad"],
        deadband_n=values["deadband_n"],
        worst_stiffness_n_m=values["worst_stiffness_n_m"],
        step_limit_rad=math.radians(values["step_limit_deg"]),
        speed_limit_rad_s=math.radians(values["speed_limit_deg_s"]),
        touch_n=values["touch_n"],
    )
    watch = WatchSettings(
        stale_after_s=values["stale_after_s"],
        resume_after_s=values["resume_after_s"],
        joint_speed_rad_s=math.radians(values["joint_speed_deg_s"]),
        settle_s=values["settle_s"],
    )
    return ControllerSettings(
        law=law,
        watch=watch,
        joint_limit_rad=math.radians(values["joint_limit_deg"]),
        measure_s=values["measure_s"],
        yield_s=values["yield_s"],
        await_command=values["await_command"],
    )


CHECK_S = 0.02
"""How often silence of the estimator is looked for."""

Array = np.ndarray


class AdmittanceNode(ConfiguredNode):
    """Configured: listens and knows what can be known. Active: sends joint commands as well."""

    def __init__(self) -> None:
        super().__init__("admittance")
        declare_parameters(self, ADMITTANCE_PARAMETERS, read_only=False)
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
        self._logged_state = ContactState.STOPPED
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
        self._arm, self._mechanism = arm, mechanism_of(arm)
        self._frames = Frames(arm.segment_count, given["frame_prefix"])
        self._joint_order = NamedOrder(arm.joint_names, "joints")
        self._estimator = given["estimator"]
        self._controller = AdmittanceController(
            self._mechanism, controller_settings(given), time.monotonic()
        )
        self._command = JointState(name=list(arm.joint_names))
        self._commands_out = self.create_publisher(
            JointState, topics.JOINT_COMMANDS, **overridable(PUBLISHER)
        )
        self._inputs = [
            self.create_subscription(kind, topic, handle, **overridable(COMMAND))
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
        self._timer = self.create_timer(CHECK_S, self._check)
        self._logged_state = ContactState.STOPPED
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
            wrench = read_wrench(message, self._frames)
        except CableSenseError as error:
            self._controller.watch.refused(f"a wrench was refused: {error}")
            self.get_logger().warning(
                f"{self._estimator}/wrench: message refused: {error}",
                throttle_duration_sec=WARN_EVERY_S,
            )
            return
        if not self._active:
            return
        command = self._controller.received_wrench(
            wrench.segment,
            wrench.force_n,
            wrench.stamp_ns,
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
            self.get_logger().warning(
                f"message refused: {error}", throttle_duration_sec=WARN_EVERY_S
            )
            return
        self._controller.watch.received_probabilities(time.monotonic())

    def _on_command(self, message: JointState) -> None:
        if self._controller is None or self._mechanism is None:
            return
        try:
            command = checked_command(
                self._mechanism, joint_command_rad(message, self._joint_order)
            )
        except CableSenseError as error:  # arm and estimator refuse it as well
            self.get_logger().warning(
                f"{topics.JOINT_COMMANDS}: message refused: {error}",
                throttle_duration_sec=WARN_EVERY_S,
            )
            return
        if self._controller.received_command(command, time.monotonic()):
            self.get_logger().warning(
                "another node commands: that pose is home from now on",
                throttle_duration_sec=WARN_EVERY_S,
            )

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        if self._controller is None:
            return
        stale = input_is_stale(message, self._estimator)
        if stale is not None:
            self._controller.watch.received_input_state(stale, time.monotonic())

    def _check(self) -> None:
        if self._controller is None:
            return
        now_s = time.monotonic()
        state = self._controller.watch.update(now_s)
        if state is ContactState.STOPPED and self._logged_state is not ContactState.STOPPED:
            self.get_logger().warning(
                f"stopped: {self._controller.watch.reason}; the arm holds its last command"
            )
        elif state is not ContactState.STOPPED and self._logged_state is ContactState.STOPPED:
            self.get_logger().info("estimates are trusted: contacts are yielded to")
        self._logged_state = state
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
