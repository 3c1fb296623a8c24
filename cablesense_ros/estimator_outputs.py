"""What the estimator node publishes for each sample: the wrench first, all else after it.

The services `~/tare` and `~/tare_undo`, and what the log says of tares.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PointStamped, Vector3Stamped, WrenchStamped
from rclpy.lifecycle import LifecycleNode, LifecyclePublisher
from rclpy.node import Node
from rclpy.service import Service
from std_msgs.msg import Float64MultiArray, MultiArrayDimension
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from cablesense_base.errors import CableSenseError
from cablesense_msgs_py import topics
from cablesense_msgs_py.journal import JournalEntry, put_journal_entry
from cablesense_msgs_py.qos import JOURNAL, PUBLISHER, WRENCH, Qos
from cablesense_msgs_py.serialized import wrench_writers
from cablesense_msgs_py.topics import Frames
from cablesense_msgs_py.wrenches import (
    Contact,
    ContactMarkers,
    describe_probabilities,
    put_contact_point,
    put_force_direction,
    put_probabilities,
)
from cablesense_online.answers import Outcome
from cablesense_online.estimation import Estimation
from cablesense_online.tare import Tare, tare_taken_line, tare_undone_line
from cablesense_ros.endpoints import overridable

DISPLAY_PERIOD_S = 1.0 / 30.0
"""Markers and probabilities come no faster than this: they are for eyes."""


class EstimatorOutputs:
    """The publishers of a configured estimator; messages are made once and reused."""

    def __init__(self, node: LifecycleNode, frames: Frames, markers: bool) -> None:
        self._node = node
        self._frames = frames
        self._next_display_s = float("-inf")
        self._wrench_out = self._create(WrenchStamped, topics.WRENCH, WRENCH)
        self._wrench_in = wrench_writers(frames)
        self._point, self._point_out = (
            PointStamped(),
            self._create(PointStamped, topics.CONTACT_POINT),
        )
        self._direction, self._direction_out = (
            Vector3Stamped(),
            self._create(Vector3Stamped, topics.FORCE_DIRECTION),
        )
        self._probabilities = Float64MultiArray()
        self._probabilities.layout.dim = [MultiArrayDimension()]
        describe_probabilities(self._probabilities.layout.dim[0], frames.segment_count)
        self._probabilities_out = self._create(Float64MultiArray, topics.CONTACT_PROBABILITIES)
        self._journal_out = self._create(DiagnosticArray, topics.JOURNAL, JOURNAL)
        self._markers = ContactMarkers(MarkerArray(), Marker, Point) if markers else None
        self._markers_out = self._create(MarkerArray, topics.MARKERS) if markers else None

    def publish(self, outcome: Outcome, stamp_ns: int, now_s: float) -> None:
        """Publish the answer to a sample.

        Args:
            outcome: the answer.
            stamp_ns: time that the outputs bear.
            now_s: monotonic time.
        """
        contact = outcome.contact
        writer = self._wrench_in[contact.segment]
        self._wrench_out.publish(writer.write(stamp_ns, contact.wrench))
        if outcome.entry is not None:
            self._publish_entry(outcome.entry)
        if contact.segment:
            self._publish_contact(contact, stamp_ns)
        if now_s >= self._next_display_s:
            self._next_display_s = now_s + DISPLAY_PERIOD_S
            self._publish_display(outcome, stamp_ns)

    def destroy(self) -> None:
        """Take the topics away."""
        for publisher in (
            self._wrench_out,
            self._point_out,
            self._direction_out,
            self._probabilities_out,
            self._journal_out,
            self._markers_out,
        ):
            if publisher is not None:
                self._node.destroy_lifecycle_publisher(publisher)

    def _create(self, kind: type, topic: str, qos: Qos = PUBLISHER) -> LifecyclePublisher:
        return self._node.create_lifecycle_publisher(kind, topic, **overridable(qos))

    def _publish_entry(self, entry: JournalEntry) -> None:
        message = DiagnosticArray()
        message.header.frame_id = self._frames.base
        put_journal_entry(message, entry, DiagnosticStatus, KeyValue)
        self._journal_out.publish(message)

    def _publish_contact(self, contact: Contact, stamp_ns: int) -> None:
        if self._point_out.get_subscription_count():
            self._point.header.stamp = _time(stamp_ns)
            put_contact_point(self._point, contact, self._frames)
            self._point_out.publish(self._point)
        if self._direction_out.get_subscription_count():
            self._direction.header.stamp = _time(stamp_ns)
            put_force_direction(self._direction, contact, self._frames)
            self._direction_out.publish(self._direction)

    def _publish_display(self, outcome: Outcome, stamp_ns: int) -> None:
        if outcome.probabilities and self._probabilities_out.get_subscription_count():
            put_probabilities(self._probabilities, outcome.probabilities)
            self._probabilities_out.publish(self._probabilities)
        if self._markers and self._markers_out and self._markers_out.get_subscription_count():
            self._markers.put(outcome.contact, self._frames, _time(stamp_ns))
            self._markers_out.publish(self._markers.array)


def _time(stamp_ns: int) -> Time:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return Time(sec=seconds, nanosec=nanoseconds)


class TareServices:
    """Takes tares, and takes them back, of an estimation that is at work."""

    def __init__(
        self,
        node: Node,
        cable_names: Sequence[str],
        estimation: Callable[[], Estimation | None],
        now_ns: Callable[[], int],
    ) -> None:
        """`estimation` gives the one at work, none while the node is not active."""
        self._node, self._cable_names = node, cable_names
        self._estimation, self._now_ns = estimation, now_ns
        self._services: list[Service] = [
            node.create_service(Trigger, topics.TARE, self._on_tare),
            node.create_service(Trigger, topics.TARE_UNDO, self._on_tare_undo),
        ]

    def destroy(self) -> None:
        """Offer them no more."""
        for service in self._services:
            self._node.destroy_service(service)
        self._services = []

    def log(self, tare: Tare, how: str) -> str:
        """Say in the log that a tare was taken; gives the line."""
        message = tare_taken_line(tare, self._cable_names, how)
        self._node.get_logger().info(message)
        return message

    def _on_tare(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, self._take)

    def _on_tare_undo(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, self._undo)

    def _answer(
        self, response: Trigger.Response, do: Callable[[Estimation], str]
    ) -> Trigger.Response:
        estimation = self._estimation()
        if estimation is None:
            response.success, response.message = False, "the node is not active"
            return response
        try:
            response.message = do(estimation)
            response.success = True
        except CableSenseError as error:
            response.success, response.message = False, str(error)
            self._node.get_logger().warning(f"tare: {error}")
        return response

    def _take(self, estimation: Estimation) -> str:
        return self.log(estimation.take_tare(self._now_ns()), "on request")

    def _undo(self, estimation: Estimation) -> str:
        undone = estimation.tare.present
        earlier = estimation.undo_tare()
        assert undone is not None  # or there would have been nothing to undo
        message = tare_undone_line(undone, earlier, self._cable_names, estimation.tare.undoable)
        self._node.get_logger().info(message)
        return message
