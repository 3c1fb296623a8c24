"""The `estimator` node: cable tensions in, contact and force out (a lifecycle node)."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

from rclpy.event_handler import QoSMessageLostInfo
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import UInt8MultiArray

from cablesense_contact.calibration_file import calibration_of, prior_notes
from cablesense_contact.reference_contacts import KnownForce
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import Level, Status
from cablesense_msgs_py.qos import COMMAND_QOS, LATCHED_QOS, SENSOR_QOS
from cablesense_online.answer import Answer
from cablesense_online.calibrated_arm import CalibratedState
from cablesense_online.estimation import Estimation
from cablesense_online.loading import load
from cablesense_online.placed_links import contact_frames
from cablesense_online.provenance import Provenance
from cablesense_online.settings import LIVE_SETTINGS, EstimationSettings
from cablesense_online.statuses import (
    ForceKnown,
    awaited_tare,
    breath_status,
    cables_status,
    model_status,
    motion_status,
    tare_status,
)
from cablesense_online.tare import Tare, TareError, tare_undone_line
from cablesense_ros.endpoints import (
    WARN_EVERY_S,
    CommandInput,
    RefusalLog,
    serve,
    steady_timer,
    subscribe_to_those_waiting,
)
from cablesense_ros.estimator_outputs import EstimatorOutputs
from cablesense_ros.node_process import ConfiguredNode, parameter_values, run_node
from cablesense_sim.compiled import leave_interpreted

STALE_CHECK_S = 0.02
"""How often silence of the input is checked for; while it lasts, a zero wrench is published."""


class EstimatorNode(ConfiguredNode):
    """Configured: model and arm loaded. Active: samples are answered."""

    def __init__(self) -> None:
        super().__init__("estimator")
        self._simulated_time = self.get_clock().ros_time_is_active
        self._lost = 0
        self._refuse_sample = RefusalLog(self, "sample refused")
        self._refuse_command = RefusalLog(self)
        serve(self, topics.TARE, self._tare)
        serve(self, topics.TARE_UNDO, self._undo_tare)
        self.add_post_set_parameters_callback(self._on_parameters)

    def _begin(self) -> None:
        """Subscribe to tensions and commands."""
        self._estimation.start(time.monotonic())
        self._outputs.publish_calibration(self._estimation, self._now_ns())
        at_end = self._while_active.callback
        samples = subscribe_to_those_waiting(
            self,
            JointState,
            topics.CABLE_TENSIONS,
            SENSOR_QOS,
            self._estimation.publisher,
            self._on_samples,
            partial(self._refuse_sample, topics.CABLE_TENSIONS),
            self._estimation.most_together,
            self._estimation.follow,
            message_lost=self._on_lost,
        )
        at_end(self.destroy_subscription, samples)
        refuse = self._refuse_command
        machine = self._loaded.machine
        offset = self._estimation.offset
        offsets = refuse.subscribe(JointState, topics.CABLE_OFFSETS, COMMAND_QOS, offset)
        at_end(self.destroy_subscription, offsets)
        calibrations = refuse.subscribe(
            UInt8MultiArray, topics.CALIBRATION, LATCHED_QOS, self._on_calibration
        )
        at_end(self.destroy_subscription, calibrations)
        commands = CommandInput(
            self,
            refuse,
            machine.command_names,
            lambda: self._estimation.state.motion.command_rad,
            self._on_command,
            topics.JOINT_STATES if machine.reads_joints else topics.JOINT_COMMANDS,
        )
        at_end(commands.destroy)
        at_end(self.destroy_timer, steady_timer(self, STALE_CHECK_S, self._check_stale))
        at_end(self._publish_zero)  # none is left standing

    def _configure(self, given: dict[str, Any]) -> None:
        self._loaded = load(given["arm"], given["model"])
        loaded = self._loaded
        machine = loaded.machine
        settings = EstimationSettings.model_validate(given)
        calibration = loaded.calibration(given["calibration_file"])
        contacts = loaded.contacts(settings)
        now_s = time.monotonic()
        self._estimation = Estimation(machine, contacts, settings, now_s, calibration)
        self._force_known: ForceKnown | None = None
        if loaded.law is not None:
            leave_interpreted()  # a network asks for an equilibrium in every pose, a law hardly
            self._force_known = ForceKnown(machine, loaded.law, loaded.reference_contacts)
        frames = contact_frames(machine, given["frame_prefix"])
        self._outputs = EstimatorOutputs(
            self._topics,
            frames,
            machine,
            given["markers"],
            given["unknown_force"],
            Provenance(
                model=loaded.path,
                sha256=loaded.sha256,
                arm=machine.identity,
                frame_prefix=given["frame_prefix"],
                settings=settings,
            ),
            on_each_segment=contacts.on_each_segment,
        )
        self._identity = machine.identity
        path = given["calibration_file"]
        known = f"calibrated by {path}" if calibration else "not calibrated"
        self.get_logger().info(f"arm {machine.identity}, model {loaded.path}, {known}: configured")
        for note in prior_notes(calibration, machine, path):
            self.get_logger().warning(note)

    def _on_samples(self, raws: Sequence[bytes]) -> None:
        now_ns = self._now_ns()
        now_s = time.monotonic()
        for answer in self._estimation.samples(raws, now_ns, now_s):
            self._outputs.publish(answer, answer.stamp_ns or now_ns, now_s)
            if answer.problem is not None:
                self._refuse_sample(topics.CABLE_TENSIONS, answer.problem)
            if answer.new_tare is not None:
                self._log_tare(answer.new_tare, "by itself (auto_tare)")
                self._outputs.publish_calibration(self._estimation, now_ns)

    def _on_command(self, message: JointState) -> None:
        if self._estimation.command(message):
            self._outputs.publish_calibration(self._estimation, self._now_ns())
            self.get_logger().warning(
                "the tare that was taken before any command is dropped: the first command is to "
                "another pose than the assumed one; auto_tare takes another once the arm rests"
            )

    def _on_calibration(self, message: UInt8MultiArray) -> None:
        """Take over the calibration of a commissioning."""
        source = topics.CALIBRATION
        calibration = calibration_of(bytes(message.data), self._loaded.machine, source)
        self._estimation.calibrate(calibration)
        self._outputs.publish_calibration(self._estimation, self._now_ns())
        self.get_logger().info(f"calibration taken over: {calibration.made_from}")

    def _require_active(self) -> None:
        if not self._active:
            raise TareError("the node is not active")

    def _tare(self) -> str:
        self._require_active()
        forced = self.get_parameter("tare_force").value
        tare = self._estimation.take_tare(self._now_ns(), forced=forced)
        self._outputs.publish_calibration(self._estimation, self._now_ns())
        return self._log_tare(tare, "on request" + " (tare_force)" * forced)

    def _undo_tare(self) -> str:
        self._require_active()
        tares = self._estimation.state.unloaded.tares
        undone = tares[-1] if tares else None
        in_force = self._estimation.undo_tare(self._now_ns())
        unloaded = self._estimation.state.unloaded
        replaced = len(unloaded.tares) == len(tares)
        self._outputs.publish_calibration(self._estimation, self._now_ns())
        if undone is None:
            message = "the calibration taken over last is undone"
        else:
            machine = self._loaded.machine
            message = tare_undone_line(
                undone, in_force, machine, unloaded.undoable, replaced=replaced
            )
        self.get_logger().info(message)
        return message

    def _log_tare(self, tare: Tare, how: str) -> str:
        message = f"tare taken {how} {tare.described(self._loaded.machine)}"
        self.get_logger().info(message)
        return message

    def _now_ns(self) -> int:
        """Time of the clock that sets stamps; the system's is read directly, as that is faster."""
        return self.get_clock().now().nanoseconds if self._simulated_time else time.time_ns()

    def _check_stale(self) -> None:
        self._simulated_time = self.get_clock().ros_time_is_active
        if awaited := self._awaited_tare():
            self.get_logger().warning(
                f"auto_tare waits: {awaited}", throttle_duration_sec=WARN_EVERY_S
            )
        now_s = time.monotonic()
        if self._estimation.miss_breather(now_s):
            self.get_logger().warning(
                "the breather fell silent in mid-breath; friction is in the readings again"
            )
        if self._estimation.stale(now_s):
            self._publish_zero()
            silence_s = self._estimation.counts.silence_s(now_s)
            self.get_logger().warning(
                f"{topics.CABLE_TENSIONS}: no sample for {silence_s:.1f} s; no force is known",
                throttle_duration_sec=WARN_EVERY_S,
            )

    def _publish_zero(self) -> None:
        self._outputs.publish(Answer(), self._now_ns(), time.monotonic())

    def _on_lost(self, event: QoSMessageLostInfo) -> None:
        self._lost += event.total_count_change

    def _on_parameters(self, parameters: list[Parameter]) -> None:
        if self._identity and any(p.name in LIVE_SETTINGS for p in parameters):
            values = parameter_values(self)
            self._estimation.adjust(**{name: values[name] for name in LIVE_SETTINGS})
            self._outputs.publish_calibration(self._estimation, self._now_ns())

    def _statuses(self) -> list[Status]:
        if not self._identity:
            return [Status("model", Level.WARN, "not configured: no model loaded")]
        estimation = self._estimation
        counts = estimation.counts
        model = model_status(self._loaded, counts.largest_force_n, active=self._active)
        counts.largest_force_n = 0.0
        if not self._active:
            return [model]
        state = estimation.state
        settings = estimation.settings
        publishers = self.count_publishers(topics.CABLE_TENSIONS)
        missing = max(self._lost, estimation.publisher.lost)
        statuses = [
            model,
            counts.status(time.monotonic(), missing, publishers, settings.stale_after_s),
            cables_status(
                counts.slack_cables, settings.slack_below_n, self._loaded.machine.channels.names
            ),
            motion_status(
                estimation.estimator,
                state,
                counts.blind_s(state.motion.last_ns),
                self._loaded.summary.pose_range_deg,
                self._refuse_command.count,
            ),
            tare_status(state, self._awaited_tare(), self._known_force()),
        ]
        breathing = breath_status(state.breath)
        if breathing is not None:
            statuses.append(breathing)
        self._lost = 0
        estimation.publisher.lost = 0
        self._refuse_command.count = 0
        return statuses

    def _awaited_tare(self) -> str:
        """Why no automatic tare is taken; else empty."""
        estimation = self._estimation
        channels = self._loaded.machine.channels
        return awaited_tare(estimation.state, estimation.settings, channels)

    def _known_force(self) -> KnownForce | None:
        """How well a push would be known elsewhere; None where that has no answer."""
        unloaded = self._estimation.state.unloaded
        if self._force_known is None or not isinstance(unloaded, CalibratedState):
            return None
        return self._force_known.by(unloaded.calibration)


main = partial(run_node, EstimatorNode)


if __name__ == "__main__":
    sys.exit(main())
