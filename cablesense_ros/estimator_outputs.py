"""The messages that the estimator node publishes for each sample: the wrench first."""

from __future__ import annotations

from collections.abc import Sequence

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PointStamped, Vector3Stamped, WrenchStamped
from rclpy.event_handler import PublisherEventCallbacks, QoSPublisherMatchedInfo
from rclpy.lifecycle import LifecycleNode, LifecyclePublisher
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension
from visualization_msgs.msg import Marker, MarkerArray

from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import (
    Contact,
    ContactMarkers,
    ForceState,
    Status,
    describe_probabilities,
    put_contact_point,
    put_force_direction,
    put_probabilities,
)
from cablesense_msgs_py.qos import JOURNAL, PUBLISHER, WRENCH, Qos
from cablesense_msgs_py.serialized import restamped, wrench_writers
from cablesense_msgs_py.topics import Frames
from cablesense_online.answer import Answer
from cablesense_online.estimation import Estimation
from cablesense_online.state import put_state
from cablesense_ros.endpoints import overridable
from cablesense_ros.node_process import diagnostic_array

DISPLAY_PERIOD_S = 1.0 / 30.0
"""Markers and probabilities are for display, and published no faster than this."""


class EstimatorOutputs:
    """The publishers of a configured estimator; messages are made once and reused."""

    def __init__(
        self,
        node: LifecycleNode,
        frames: Frames,
        identity: str,
        markers: bool,
        unknown_force: str,
        estimation: Estimation,
        joint_names: Sequence[str],
    ) -> None:
        """`identity` is the arm's, `unknown_force` as in `EstimationSettings`."""
        self._node, self._estimation = node, estimation
        self._unknown_force = unknown_force
        self._frames = frames
        self._outputs: list[_Output] = []
        self._next_display_s = float("-inf")
        self._wrench_out = self._create(WrenchStamped, topics.WRENCH, WRENCH)
        self._wrench_in = wrench_writers(frames)
        self._status_out = self._create(DiagnosticArray, topics.STATUS)
        self._status: dict[ForceState, bytes] = {}
        for state in ForceState:
            status = Status("force", state.level, state.value)
            self._status[state] = serialize_message(diagnostic_array(node, [status], identity))
        self._bounds_out = [
            self._create(WrenchStamped, topic)
            for topic in (topics.WRENCH_LOWER, topics.WRENCH_UPPER)
        ]
        self._base_out = self._create(WrenchStamped, topics.WRENCH_BASE)
        self._torques_out = self._create(JointState, topics.JOINT_TORQUES)
        self._torques = JointState(name=list(joint_names))
        self._torques.header.frame_id = frames.base
        count = frames.segment_count if estimation.several else 0
        self._segments_out = [
            self._create(WrenchStamped, topics.SEGMENT_WRENCHES.format(number))
            for number in range(1, count + 1)
        ]
        self._point, self._direction = PointStamped(), Vector3Stamped()
        self._point_out = self._create(PointStamped, topics.CONTACT_POINT)
        self._direction_out = self._create(Vector3Stamped, topics.FORCE_DIRECTION)
        self._probabilities = Float64MultiArray()
        self._probabilities.layout.dim = [MultiArrayDimension()]
        describe_probabilities(self._probabilities.layout.dim[0], frames.segment_count)
        self._probabilities_out = self._create(Float64MultiArray, topics.CONTACT_PROBABILITIES)
        self._journal_out = self._create(DiagnosticArray, topics.JOURNAL, JOURNAL)
        most = max(1, count)
        self._markers = ContactMarkers(MarkerArray(), Marker, Point, most) if markers else None
        self._markers_out = self._create(MarkerArray, topics.MARKERS) if markers else None

    def publish(self, answer: Answer, stamp_ns: int, now_s: float) -> None:
        """Publish the answer to a sample, stamped `stamp_ns`, at monotonic time `now_s`."""
        contact, wrench = answer.contact, answer.wrench(self._unknown_force)
        if wrench is not None:
            writer = self._wrench_in[contact.segment]
            self._wrench_out.publish(writer.write(stamp_ns, wrench))
        if self._status_out.subscribed:
            self._status_out.publish(restamped(self._status[answer.force], stamp_ns))
        if wrench is not None:
            self._publish_whole(answer, wrench, stamp_ns)
        lower, upper = self._bounds_out
        if (lower.subscribed or upper.subscribed) and answer.bounds is not None:
            for out, bound in zip(self._bounds_out, answer.bounds, strict=True):
                if out.subscribed:
                    writer = self._wrench_in[bound.segment]
                    out.publish(writer.write(stamp_ns, bound.wrench))
        if answer.state is not None:
            message = DiagnosticArray()
            message.header.frame_id = self._frames.base
            put_state(message, answer.state, DiagnosticStatus, KeyValue)
            self._journal_out.publish(message)
        if contact.segment:
            self._publish_contact(contact, stamp_ns)
        if now_s >= self._next_display_s:
            self._next_display_s = now_s + DISPLAY_PERIOD_S
            self._publish_display(answer, stamp_ns)

    def destroy(self) -> None:
        """Take the topics away."""
        for out in self._outputs:
            self._node.destroy_lifecycle_publisher(out.publisher)

    def _create(self, kind: type, topic: str, qos: Qos = PUBLISHER) -> _Output:
        self._outputs.append(_Output(self._node, kind, topic, qos))
        return self._outputs[-1]

    def _publish_contact(self, contact: Contact, stamp_ns: int) -> None:
        for out, message, put in (
            (self._point_out, self._point, put_contact_point),
            (self._direction_out, self._direction, put_force_direction),
        ):
            if out.subscribed:
                message.header.stamp = _time(stamp_ns)
                put(message, contact, self._frames)
                out.publish(message)

    def _publish_whole(self, answer: Answer, wrench: Sequence[float], stamp_ns: int) -> None:
        """The force in base axes, at the joints and, of several contacts, on each segment."""
        contacts = answer.contacts
        if self._base_out.subscribed:
            if contacts:
                wrench = self._estimation.at_pose.base_wrench(contacts)
            self._base_out.publish(self._wrench_in[0].write(stamp_ns, wrench))
        if self._torques_out.subscribed:
            self._torques.header.stamp = _time(stamp_ns)
            self._torques.effort = (
                self._estimation.at_pose.joint_torques_n_m(contacts)
                if contacts
                else [wrench[0]] * len(self._torques.name)  # zero, or not known
            )
            self._torques_out.publish(self._torques)
        for number, out in enumerate(self._segments_out, start=1):
            on_it = answer.on_segment(number, self._unknown_force) if out.subscribed else None
            if on_it is not None:
                out.publish(self._wrench_in[number].write(stamp_ns, on_it))

    def _publish_display(self, answer: Answer, stamp_ns: int) -> None:
        if answer.probabilities and self._probabilities_out.subscribed:
            put_probabilities(self._probabilities, answer.probabilities)
            self._probabilities_out.publish(self._probabilities)
        if self._markers and self._markers_out and self._markers_out.subscribed:
            self._markers.put(answer.contacts, self._frames, _time(stamp_ns))
            self._markers_out.publish(self._markers.array)


class _Output:
    """A topic of a node, and whether anyone subscribes: to ask that takes longer than a sum."""

    def __init__(self, node: LifecycleNode, kind: type, topic: str, qos: Qos) -> None:
        self.subscribed = False
        self.publisher: LifecyclePublisher = node.create_lifecycle_publisher(
            kind,
            topic,
            **overridable(qos),
            event_callbacks=PublisherEventCallbacks(matched=self._matched),
        )
        self.publish = self.publisher.publish

    def _matched(self, event: QoSPublisherMatchedInfo) -> None:
        self.subscribed = event.current_count > 0


def _time(stamp_ns: int) -> Time:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return Time(sec=seconds, nanosec=nanoseconds)
