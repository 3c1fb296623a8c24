"""The `estimator` node: cable tensions in, contact and force out (a lifecycle node)."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from rclpy.event_handler import QoSMessageLostInfo, SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from cablesense_base.errors import CableSenseError
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import Level, Status
from cablesense_msgs_py.qos import COMMAND, SENSOR
from cablesense_msgs_py.topics import Frames
from cablesense_online.estimation import Answer, Estimation
from cablesense_online.models import LoadedModel, load_model
from cablesense_online.samples import ProblemKind, SampleError
from cablesense_online.state import LIVE_SETTINGS, EstimationSettings, StateFile
from cablesense_online.tare import Tare, TareError, tare_taken_line, tare_undone_line
from cablesense_ros.estimator_outputs import EstimatorOutputs
from cablesense_ros.node_process import (
    WARN_EVERY_S,
    ConfiguredNode,
    DiagnosticsPublisher,
    NodeParameter,
    declare_parameters,
    overridable,
    parameter_values,
    run_configured_node,
)

ESTIMATOR_PARAMETERS: Final = (
    NodeParameter("arm", "cdsm", "Arm file: the name of a bundled one, or a path."),
    NodeParameter(
        "model", "", "Model file: the name of a bundled one, or a path; empty: the arm's own."
    ),
    NodeParameter(
        "autostart", True, "Configure and activate at start, without a lifecycle manager."
    ),
    NodeParameter("frame_prefix", "", "Goes before every frame name."),
    NodeParameter(
        "contact_threshold",
        0.5,
        "Probability of a contact from which on it is reported; below, the wrench is zero.",
        0.0,
        1.0,
    ),
    NodeParameter(
        "stale_after_s",
        0.2,
        "Without a sample for this long, or with one older than this, the wrench is zero, s.",
        0.001,
        60.0,
    ),
    NodeParameter(
        "slack_below_n", 1.0, "A cable below this tension, N, is reported as slack.", 0.0, 1000.0
    ),
    NodeParameter("tare_samples", 50, "Readings that a tare averages.", 1, 10_000),
    NodeParameter(
        "tare_steady_n",
        1.0,
        "Largest standard deviation of a cable's readings during a tare, N; more is not at rest.",
        0.001,
        1000.0,
    ),
    NodeParameter(
        "auto_tare",
        True,
        "Take the first readings at rest as the unloaded state; else wait for ~/tare.",
    ),
    NodeParameter(
        "state_file",
        "",
        "File that keeps tare and command, so that an estimator that was killed continues with "
        "them instead of mistaking a loaded arm for the unloaded one; empty: none is kept.",
    ),
    NodeParameter(
        "state_within_s",
        60.0,
        "The file is used when its estimator was alive at most this long ago, s.",
        1.0,
        86_400.0,
    ),
    NodeParameter(
        "joint_speed_deg_s",
        20.0,
        "Peak speed at which joints approach a command, degrees per second.",
        0.1,
        360.0,
    ),
    NodeParameter(
        "settle_s",
        0.5,
        "Time for the arm to come to rest after the joints must have arrived at a new command, s; "
        "until then the wrench is zero.",
        0.0,
        60.0,
    ),
    NodeParameter("markers", True, "Publish ~/markers."),
)


def estimation_settings(values: Mapping[str, Any]) -> EstimationSettings:
    """The settings in the parameters' values; `LIVE_SETTINGS` may change at any time."""
    speed_rad_s = math.radians(values["joint_speed_deg_s"])
    return EstimationSettings.model_validate({**values, "joint_speed_rad_s": speed_rad_s})


STALE_CHECK_S = 0.02
"""How often silence of the input is checked for; while it lasts, a zero wrench is published."""


class EstimatorNode(ConfiguredNode):
    """Configured: model and arm loaded. Active: every sample is answered with a wrench."""

    def __init__(self) -> None:
        super().__init__("estimator")
        declare_parameters(self, ESTIMATOR_PARAMETERS, read_only=False)
        self._loaded: LoadedModel | None = None
        self._estimation: Estimation | None = None
        self._state = StateFile("", 0.0)
        self._outputs: EstimatorOutputs | None = None
        self._tare_services: list[Service] = []
        self._inputs: list[Subscription] = []
        self._stale_timer: Timer | None = None
        self._simulated_time = self.get_clock().ros_time_is_active
        self._lost = 0
        self._refused_commands = 0
        self._warned_s: dict[ProblemKind, float] = {}
        self.add_post_set_parameters_callback(self._on_parameters)
        DiagnosticsPublisher(
            self, self._statuses, lambda: self._loaded.arm.identity if self._loaded else ""
        )

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Subscribe to tensions and commands."""
        result = super().on_activate(state)
        if self._estimation is not None:
            self._estimation.start(time.monotonic())
        self._inputs = [
            self.create_subscription(
                JointState,
                topics.CABLE_TENSIONS,
                self._on_sample,
                **overridable(SENSOR),
                raw=True,
                event_callbacks=SubscriptionEventCallbacks(message_lost=self._on_lost),
            ),
            self.create_subscription(
                JointState,
                topics.JOINT_COMMANDS,
                self._on_command,
                **overridable(COMMAND),
            ),
        ]
        self._stale_timer = self.create_timer(STALE_CHECK_S, self._check_stale)
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave a zero wrench behind and unsubscribe."""
        self._publish_zero()
        self._unsubscribe()
        return super().on_deactivate(state)

    def _configure(self) -> None:
        given = parameter_values(self, ESTIMATOR_PARAMETERS)
        self._loaded = load_model(given["arm"], given["model"])
        self._estimation = self._make_estimation(given, self._loaded)
        self._state = StateFile(given["state_file"], given["state_within_s"])
        self._restore_state(given, self._loaded)
        frames = Frames(self._loaded.arm.segment_count, given["frame_prefix"])
        self._outputs = EstimatorOutputs(self, frames, given["markers"])
        self._tare_services = [
            self.create_service(Trigger, topics.TARE, self._on_tare),
            self.create_service(Trigger, topics.TARE_UNDO, self._on_tare_undo),
        ]
        self.get_logger().info(
            f"arm {self._loaded.arm.identity}, model {self._loaded.model}: configured"
        )

    def _make_estimation(self, given: Mapping[str, Any], loaded: LoadedModel) -> Estimation:
        return Estimation(
            loaded.arm,
            loaded.estimator,
            estimation_settings(given),
            time.monotonic(),
            loaded.origin | {"frame_prefix": given["frame_prefix"]},
        )

    def _restore_state(self, given: Mapping[str, Any], loaded: LoadedModel) -> None:
        """Continue from the state of an estimator that was killed a moment ago."""
        try:
            state = self._state.read(loaded.arm.identity)
            if state is None or self._estimation is None:
                return
            self._estimation.restore(state)
        except CableSenseError as error:
            self._estimation = self._make_estimation(given, loaded)
            self.get_logger().warning(f"starts anew, without tare: {error}")
            return
        self.get_logger().info(
            f"goes on with the tare and the command of {given['state_file']}; if the arm was "
            "changed since, call ~/tare with nothing touching it"
        )

    def _unsubscribe(self) -> None:
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        self._inputs = []
        if self._stale_timer is not None:
            self.destroy_timer(self._stale_timer)
            self._stale_timer = None

    def _release(self) -> None:
        self._unsubscribe()
        for service in self._tare_services:
            self.destroy_service(service)
        if self._outputs is not None:
            self._outputs.destroy()
        self._tare_services = []
        self._loaded, self._estimation, self._outputs = None, None, None

    def _on_sample(self, raw: bytes) -> None:
        if self._estimation is None or self._outputs is None:
            return
        now_ns, now_s = self._now_ns(), time.monotonic()
        answer = self._estimation.sample(raw, now_ns, now_s)
        self._outputs.publish(answer, answer.stamp_ns or now_ns, now_s)
        if answer.problem is not None:
            self._warn_of_sample(answer.problem, now_s)
        if answer.new_tare is not None:
            self._log_tare(answer.new_tare, "by itself at start (auto_tare)")
        if answer.state is not None:
            self._state.keep(answer.state)

    def _warn_of_sample(self, problem: SampleError, now_s: float) -> None:
        """Each kind on its own, where rclpy would throttle all warnings of one line together."""
        if now_s - self._warned_s.get(problem.kind, -WARN_EVERY_S) >= WARN_EVERY_S:
            self._warned_s[problem.kind] = now_s
            self.get_logger().warning(f"{topics.CABLE_TENSIONS}: sample refused: {problem}")

    def _on_command(self, message: JointState) -> None:
        if self._estimation is None:
            return
        try:
            self._estimation.command(message)
        except CableSenseError as error:
            self._refused_commands += 1
            self.get_logger().warning(
                f"{topics.JOINT_COMMANDS}: message refused: {error}",
                throttle_duration_sec=WARN_EVERY_S,
            )

    def _on_tare(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer_service(
            response,
            lambda estimation: self._log_tare(estimation.take_tare(self._now_ns()), "on request"),
        )

    def _on_tare_undo(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer_service(response, self._undo_tare)

    def _answer_service(
        self, response: Trigger.Response, act: Callable[[Estimation], str]
    ) -> Trigger.Response:
        try:
            if self._estimation is None or not self._inputs:
                raise TareError("the node is not active")
            response.message = act(self._estimation)
            response.success = True
        except CableSenseError as error:
            response.success, response.message = False, str(error)
            self.get_logger().warning(f"tare: {error}")
        return response

    def _log_tare(self, tare: Tare, how: str) -> str:
        message = tare_taken_line(tare, self._cable_names, how)
        self.get_logger().info(message)
        return message

    def _undo_tare(self, estimation: Estimation) -> str:
        undone = estimation.tares.present
        earlier = estimation.undo_tare()
        assert undone is not None  # or there would have been nothing to undo
        undoable = estimation.tares.undoable
        message = tare_undone_line(undone, earlier, self._cable_names, undoable)
        self.get_logger().info(message)
        return message

    @property
    def _cable_names(self) -> tuple[str, ...]:
        return self._loaded.arm.cable_names if self._loaded else ()

    def _now_ns(self) -> int:
        """Time of the clock that sets stamps; the system's is read directly, as that is faster."""
        return self.get_clock().now().nanoseconds if self._simulated_time else time.time_ns()

    def _check_stale(self) -> None:
        self._simulated_time = self.get_clock().ros_time_is_active
        self._keep_state()
        now_s = time.monotonic()
        if self._estimation is None or not self._estimation.stale(now_s):
            return
        self._publish_zero()
        silence_s = self._estimation.health.silence_s(now_s)
        self.get_logger().warning(
            f"{topics.CABLE_TENSIONS}: no sample for {silence_s:.1f} s; the wrench is zero",
            throttle_duration_sec=WARN_EVERY_S,
        )

    def _keep_state(self) -> None:
        try:
            self._state.flush()
        except CableSenseError as error:
            self.get_logger().warning(
                f"the state is not kept: {error}",
                throttle_duration_sec=WARN_EVERY_S,
            )

    def _publish_zero(self) -> None:
        if self._outputs is not None:
            self._outputs.publish(Answer(), self._now_ns(), time.monotonic())

    def _on_lost(self, event: QoSMessageLostInfo) -> None:
        self._lost += event.total_count_change

    def _on_parameters(self, parameters: list[Parameter]) -> None:
        if self._estimation is not None and any(p.name in LIVE_SETTINGS for p in parameters):
            given = parameter_values(self, ESTIMATOR_PARAMETERS)
            self._estimation.adjust(**{name: given[name] for name in LIVE_SETTINGS})

    def _statuses(self) -> list[Status]:
        if self._estimation is None or self._loaded is None:
            return [Status("model", Level.WARN, "not configured: no model loaded")]
        estimation, active = self._estimation, bool(self._inputs)
        model = self._loaded.status(estimation.largest_force_n, active)
        estimation.largest_force_n = 0.0
        if not active:
            return [model]
        publishers = self.count_publishers(topics.CABLE_TENSIONS)
        statuses = [
            model,
            estimation.health.status(time.monotonic(), self._lost, publishers),
            estimation.check.status(),
            estimation.gate.status(
                self._loaded.estimator.metadata.pose_range_deg,
                self._refused_commands,
                received=estimation.command_received,
                in_motion=estimation.answers_in_motion,
            ),
            estimation.tares.status(),
        ]
        self._lost = self._refused_commands = 0
        return statuses


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; the process's exit code."""
    return run_configured_node(EstimatorNode, args)


if __name__ == "__main__":
    sys.exit(main())
