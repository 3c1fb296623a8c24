"""The `admittance` node: moves the arm away from contacts that the estimator finds."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from cablesense_base.arrays import Array
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
    ARM,
    AUTOSTART,
    FRAME_PREFIX,
    JOINT_SPEED,
    WARN_EVERY_S,
    ConfiguredNode,
    DiagnosticsPublisher,
    NodeParameter,
    RefusalLog,
    declare_parameters,
    of_node,
    overridable,
    parameter_values,
    run_configured_node,
)
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.dynamics import checked_command
from cablesense_sim.mechanism import Mechanism

ADMITTANCE_PARAMETERS: Final = (
    ARM,
    AUTOSTART,
    FRAME_PREFIX,
    JOINT_SPEED,
    NodeParameter("estimator", "estimator", "Name of the estimator node that is used."),
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
    NodeParameter("step_limit_deg", 1.0, "No joint turns farther in a step, deg.", 0.01, 10.0),
    NodeParameter(
        "speed_limit_deg_s", 5.0, "Nor, from one step to the next, faster, deg/s.", 0.01, 90.0
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
        "yield_s", 2.0, "After another node's command none is sent for this long, s.", 0.0, 3600.0
    ),
    NodeParameter(
        "await_command",
        False,
        "Send nothing before a command was received; else the arm is assumed to be straight.",
    ),
    NodeParameter(
        "settle_s",
        0.5,
        "How long the estimator gives no estimate after a move, s; as its own.",
        0.0,
        60.0,
    ),
)


def _controller_settings(values: Mapping[str, Any]) -> ControllerSettings:
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


SILENCE_CHECK_S = 0.02
"""How often silence of the estimator is checked for."""


class AdmittanceNode(ConfiguredNode):
    """Configured: receives and knows what can be known. Active: sends joint commands as well."""

    def __init__(self) -> None:
        super().__init__("admittance")
        declare_parameters(self, ADMITTANCE_PARAMETERS, read_only=False)
        self._identity = ""
        self._controller: AdmittanceController | None = None
        self._command = JointState()
        self._commands_out: Publisher | None = None
        self._inputs: list[Subscription] = []
        self._timer: Timer | None = None
        self._active = False
        self._logged_state = ContactState.STOPPED
        self._refuse = RefusalLog(self)
        DiagnosticsPublisher(self, self._statuses, lambda: self._identity)

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
        mechanism = mechanism_of(arm)
        settings = _controller_settings(given)
        controller = AdmittanceController(mechanism, settings, time.monotonic())
        frames = Frames(arm.segment_count, given["frame_prefix"])
        joints = NamedOrder(arm.joint_names, "joints")
        self._identity, self._controller = arm.identity, controller
        self._command = JointState(name=list(arm.joint_names))
        self._commands_out = self.create_publisher(
            JointState, topics.JOINT_COMMANDS, **overridable(PUBLISHER)
        )

        def on_probabilities(message: Float64MultiArray) -> None:
            check_probabilities(message, arm.segment_count)
            controller.watch.received_probabilities(time.monotonic())

        def on_diagnostics(message: DiagnosticArray) -> None:
            stale = input_is_stale(message, given["estimator"])
            if stale is not None:
                controller.watch.received_input_state(stale, time.monotonic())

        inputs: tuple[tuple[type, str, Callable[[Any], None], str], ...] = (
            (
                WrenchStamped,
                topics.WRENCH,
                partial(self._on_wrench, controller, frames),
                "a wrench was refused",
            ),
            (
                Float64MultiArray,
                topics.CONTACT_PROBABILITIES,
                on_probabilities,
                "probabilities were refused",
            ),
            (
                JointState,
                topics.JOINT_COMMANDS,
                partial(self._on_command, controller, mechanism, joints),
                "",  # arm and estimator refuse it as well
            ),
            (DiagnosticArray, topics.DIAGNOSTICS, on_diagnostics, ""),
        )
        for kind, topic, handle, stops in inputs:
            name = of_node(given["estimator"], topic)
            take = partial(self._take, controller, name, handle, stops)
            self._inputs.append(self.create_subscription(kind, name, take, **overridable(COMMAND)))
        self._timer = self.create_timer(SILENCE_CHECK_S, partial(self._check_silence, controller))
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
        self._controller, self._identity = None, ""

    def _take(
        self,
        controller: AdmittanceController,
        topic: str,
        handle: Callable[[Any], None],
        stops: str,
        message: Any,
    ) -> None:
        """Handle a message; one that breaks the contract is logged, and with `stops` stops."""
        try:
            handle(message)
        except CableSenseError as error:
            if stops:
                controller.watch.refused(f"{stops}: {error}")
            self._refuse(topic, error)

    def _on_wrench(
        self, controller: AdmittanceController, frames: Frames, message: WrenchStamped
    ) -> None:
        wrench = read_wrench(message, frames)
        if self._active:
            now_ns, now_s = self.get_clock().now().nanoseconds, time.monotonic()
            segment, force_n, stamp_ns = wrench
            self._send(controller.received_wrench(segment, force_n, stamp_ns, now_ns, now_s))

    def _on_command(
        self,
        controller: AdmittanceController,
        mechanism: Mechanism,
        joints: NamedOrder,
        message: JointState,
    ) -> None:
        command = checked_command(mechanism, joint_command_rad(message, joints))
        if controller.received_command(command, time.monotonic()):
            self.get_logger().warning(
                "another node commands: that pose is home from now on",
                throttle_duration_sec=WARN_EVERY_S,
            )

    def _check_silence(self, controller: AdmittanceController) -> None:
        now_s = time.monotonic()
        state, before = controller.watch.update(now_s), self._logged_state
        if state is ContactState.STOPPED and before is not ContactState.STOPPED:
            self.get_logger().warning(
                f"stopped: {controller.watch.reason}; the arm holds its last command"
            )
        elif state is not ContactState.STOPPED and before is ContactState.STOPPED:
            self.get_logger().info("estimates are trusted: contacts are yielded to")
        self._logged_state = state
        if self._active:
            self._send(controller.repeated(now_s))

    def _send(self, command_rad: Array | None) -> None:
        if self._commands_out is not None and command_rad is not None:
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
