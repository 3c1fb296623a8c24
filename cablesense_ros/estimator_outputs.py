"""The messages that the estimator node publishes for each sample: the wrench first."""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import nan
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import (
    Point,
    Point32,
    PointStamped,
    Polygon,
    PolygonStamped,
    PoseWithCovarianceStamped,
    Quaternion,
    Vector3,
    Vector3Stamped,
    WrenchStamped,
)
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, Header, MultiArrayDimension, UInt8MultiArray
from visualization_msgs.msg import Marker, MarkerArray

from cablesense_base import Array
from cablesense_contact.calibration_file import calibration_bytes
from cablesense_contact.estimate import NORMAL_95
from cablesense_contact.felt import FeltMachine
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import NO_CONTACT, UNKNOWN_WRENCH, Contact, ForceState, Status
from cablesense_msgs_py.qos import LATCHED_QOS, WRENCH_QOS
from cablesense_msgs_py.serialized import restamped, wrench_writers
from cablesense_msgs_py.topics import Frames
from cablesense_online.answer import Answer, ContactStatics
from cablesense_online.calibrated_arm import CalibratedState
from cablesense_online.estimation import Estimation
from cablesense_online.placed_links import PlacedLinks
from cablesense_online.provenance import Beginning, Provenance
from cablesense_ros.endpoints import Outputs, message_class
from cablesense_ros.node_process import diagnostic_array

DISPLAY_PERIOD_S = 1.0 / 30.0
"""Markers and probabilities are for display, and published no faster than this."""
ARROW_M_PER_N = 0.004
"""Length of the arrow per newton: 50 N are 0.2 m."""
_SPHERE_DIAMETER_M = 0.03
"""Of the marker of a contact's place."""
_ARROW_DIAMETERS_M = (0.012, 0.024, 0.03)  # shaft, head and head length
_BAND_WIDTH_M = 0.04
"""Of the marker of the interval of this place."""
_SHORTEST_BAND_M = 0.002
"""Of this marker, so that it stays visible."""
_BAND_OPACITY = 0.4
"""Of this marker: the arm stays visible."""
_COLOUR = (0.95, 0.35, 0.1, 1.0)
"""Of all markers, red, green, blue and opacity."""


class EstimatorOutputs:
    """The topics of a configured estimator."""

    def __init__(
        self,
        outputs: Outputs,
        frames: Frames,
        machine: FeltMachine,
        markers: bool,
        unknown_force: str,
        provenance: Provenance,
        *,
        on_each_segment: bool,
    ) -> None:
        """`unknown_force` is as in `EstimationSettings`.

        `on_each_segment` is whether the force on each segment is stated.
        """
        self._machine = machine
        self._placed = PlacedLinks(machine.link_frames)
        self._statics: tuple[Array, ContactStatics] | None = None
        self._frames = frames
        self._unknown_force = unknown_force
        self._provenance = provenance
        self._next_display_s = float("-inf")
        self._writers = wrench_writers(frames)
        self._wrench_out = outputs.make(WrenchStamped, topics.WRENCH, WRENCH_QOS)
        self._status_out = outputs.make(DiagnosticArray, topics.STATUS)
        self._node = outputs.node
        self._identity = machine.identity
        self._statuses = {state: self._status(state) for state in ForceState}
        estimate = message_class("cablesense_msgs/msg/ForceEstimate")
        self._estimate: Any = estimate and estimate()
        self._estimate_out = outputs.make(estimate, topics.ESTIMATE) if estimate else None
        self._lower_out = outputs.make(WrenchStamped, topics.WRENCH_LOWER)
        self._upper_out = outputs.make(WrenchStamped, topics.WRENCH_UPPER)
        self._base_out = outputs.make(WrenchStamped, topics.WRENCH_BASE)
        self._torques_out = outputs.make(JointState, topics.JOINT_TORQUES)
        self._torques = JointState(name=list(machine.torque_names))
        self._torques.header.frame_id = frames.base
        count = frames.segment_count if on_each_segment else 0
        self._segments_out = [
            outputs.make(WrenchStamped, topics.SEGMENT_WRENCHES.format(number))
            for number in range(1, count + 1)
        ]
        self._point_out = outputs.make(PointStamped, topics.CONTACT_POINT)
        self._region_out = outputs.make(PolygonStamped, topics.CONTACT_REGION)
        self._pose_out = outputs.make(PoseWithCovarianceStamped, topics.CONTACT_POSE)
        self._covariance_out = outputs.make(Float64MultiArray, topics.CONTACT_COVARIANCE)
        self._covariance = Float64MultiArray()
        numbers = "place,force_x,force_y,force_z"
        self._covariance.layout.dim = [
            MultiArrayDimension(label=numbers, size=4, stride=4 * size) for size in (4, 1)
        ]
        self._direction_out = outputs.make(Vector3Stamped, topics.FORCE_DIRECTION)
        where_out = self._point_out, self._region_out, self._pose_out
        self._contact_outs = *where_out, self._covariance_out, self._direction_out
        self._probabilities_out = outputs.make(Float64MultiArray, topics.CONTACT_PROBABILITIES)
        labels = ["none", *machine.link_names]
        self._probabilities = Float64MultiArray()
        self._probabilities.layout.dim = [
            MultiArrayDimension(label=",".join(labels), size=len(labels), stride=len(labels))
        ]
        self._calibration_out = outputs.make(UInt8MultiArray, topics.CALIBRATION_USED, LATCHED_QOS)
        self._markers_out = outputs.make(MarkerArray, topics.MARKERS) if markers else None
        self._most_shown = max(1, count)

    def publish(self, answer: Answer, stamp_ns: int, now_s: float) -> None:
        """Publish the answer to a sample, stamped `stamp_ns`, at monotonic time `now_s`."""
        contact = answer.contact
        wrench = answer.wrench(self._unknown_force)
        if wrench is not None:
            placed = self._placed.wrench(contact.segment, wrench)
            self._wrench_out.publish(self._writers[contact.segment].write(stamp_ns, placed))
        if self._status_out.subscribed:
            status = self._statuses[answer.force]
            if answer.doubt:
                status = self._status(answer.force, {"or": answer.doubt})
            self._status_out.publish(restamped(status, stamp_ns))
        if self._estimate_out and self._estimate_out.subscribed:
            in_base = self._in_base(answer, "nan")
            put_estimate(
                self._estimate, answer, in_base, self._frames, self._placed, _time(stamp_ns)
            )
            self._estimate_out.publish(self._estimate)
        if wrench is not None:
            self._publish_whole(answer, wrench, stamp_ns)
        if answer.bounds is not None:
            outs = (self._lower_out, self._upper_out)
            for out, bound in zip(outs, answer.bounds, strict=True):
                if out.subscribed:
                    placed = self._placed.wrench(bound.segment, bound.wrench)
                    out.publish(self._writers[bound.segment].write(stamp_ns, placed))
        if contact.segment and any(out.subscribed for out in self._contact_outs):
            self._publish_contact(answer, stamp_ns)
        if now_s >= self._next_display_s:
            self._next_display_s = now_s + DISPLAY_PERIOD_S
            self._publish_display(answer, stamp_ns)

    def _status(self, state: ForceState, values: Mapping[str, str] | None = None) -> bytes:
        """The serialized status of a force, without a stamp."""
        status = Status("force", state.level, state.value, values or {})
        return serialize_message(diagnostic_array(self._node, [status], self._identity))

    def publish_calibration(self, estimation: Estimation, now_ns: int) -> None:
        """Publish what answers rest on from the next sample on: a calibration and its provenance.

        A network has none.
        """
        state = estimation.state
        unloaded = state.unloaded
        if not isinstance(unloaded, CalibratedState):
            return
        content = calibration_bytes(unloaded.calibration)
        message = UInt8MultiArray(data=array("B", content))
        command_rad = tuple(state.motion.command_rad.tolist())
        beginning = Beginning(now_ns, state.stamps.last_ns, command_rad, unloaded.known)
        provenance = replace(self._provenance, settings=estimation.settings)
        label = provenance.as_json(beginning)
        size = len(content)
        message.layout.dim = [MultiArrayDimension(label=label, size=size, stride=size)]
        self._calibration_out.publish(message)

    def _publish_whole(self, answer: Answer, wrench: Sequence[float], stamp_ns: int) -> None:
        """The force in base axes, at the joints and, of several contacts, on each segment."""
        contacts = answer.contacts
        if self._base_out.subscribed:
            in_base = self._in_base(answer, self._unknown_force)
            self._base_out.publish(self._writers[0].write(stamp_ns, in_base))
        if self._torques_out.subscribed:
            self._torques.header.stamp = _time(stamp_ns)
            self._torques.effort = (
                self._statics_of(answer).joint_torques_n_m(contacts)
                if contacts
                else [wrench[0]] * len(self._torques.name)  # zero, or not known
            )
            self._torques_out.publish(self._torques)
        for number, out in enumerate(self._segments_out, start=1):
            on_it = answer.on_segment(number, self._unknown_force) if out.subscribed else None
            if on_it is not None:
                placed = self._placed.wrench(number, on_it)
                out.publish(self._writers[number].write(stamp_ns, placed))

    def _in_base(self, answer: Answer, unknown_force: str) -> Sequence[float]:
        """The wrench (6,) of all contacts about the base; one of known moment only leaves none."""
        if not answer.contacts:
            return answer.wrench(unknown_force) or UNKNOWN_WRENCH
        if unknown_force == "nan" and not all(contact.magnitude_n for contact in answer.contacts):
            return UNKNOWN_WRENCH
        return self._statics_of(answer).base_wrench(answer.contacts)

    def _statics_of(self, answer: Answer) -> ContactStatics:
        """Statics at the pose that an answer is for, which is mostly that of the last one."""
        pose_rad = answer.pose_rad
        assert pose_rad is not None  # an answer with contacts has one
        if self._statics is None or not np.array_equal(self._statics[0], pose_rad):
            self._statics = pose_rad, ContactStatics(self._machine.links_at(pose_rad))
        return self._statics[1]

    def _publish_contact(self, answer: Answer, stamp_ns: int) -> None:
        contact = answer.contact
        region_m = answer.region_m
        estimate = answer.estimate
        stamp = _time(stamp_ns)
        header = Header(frame_id=self._frames.segment(contact.segment), stamp=stamp)
        if self._point_out.subscribed:
            x, y, z = self._placed.point(contact.segment, contact.contact_m)
            self._point_out.publish(PointStamped(header=header, point=Point(x=x, y=y, z=z)))
        if region_m is not None and self._region_out.subscribed:
            places = [self._placed.point(contact.segment, place_m) for place_m in region_m]
            ends = Polygon(points=[Point32(x=x, y=y, z=z) for x, y, z in places])
            self._region_out.publish(PolygonStamped(header=header, polygon=ends))
        if region_m and estimate and self._pose_out.subscribed:
            std_m = (region_m[1] - region_m[0]) / (2.0 * NORMAL_95)
            statics = self._statics_of(answer)
            contact_pose = statics.contact_pose(contact, std_m, estimate.angle_std_deg)
            message = PoseWithCovarianceStamped()
            message.header.frame_id = self._frames.base
            message.header.stamp = stamp
            pose = message.pose.pose
            pose.position = Point(**dict(zip("xyz", contact_pose.point_m, strict=True)))
            pose.orientation = Quaternion(
                **dict(zip("xyzw", contact_pose.quaternion, strict=True))
            )
            message.pose.covariance = contact_pose.covariance
            self._pose_out.publish(message)
        if estimate and estimate.place and self._covariance_out.subscribed:
            self._covariance.data = array("d", estimate.place.covariance.ravel().tolist())
            self._covariance_out.publish(self._covariance)
        if self._direction_out.subscribed:
            x, y, z = self._placed.direction(contact.segment, contact.direction)
            vector = Vector3(x=x, y=y, z=z)
            self._direction_out.publish(Vector3Stamped(header=header, vector=vector))

    def _publish_display(self, answer: Answer, stamp_ns: int) -> None:
        if answer.probabilities and self._probabilities_out.subscribed:
            self._probabilities.data = array("d", answer.probabilities)
            self._probabilities_out.publish(self._probabilities)
        if self._markers_out and self._markers_out.subscribed:
            shown = answer.contacts, answer.region_m, _time(stamp_ns)
            self._markers_out.publish(
                contact_markers(self._frames, self._placed, self._most_shown, *shown)
            )


def put_estimate(
    message: Any,
    answer: Answer,
    in_base: Sequence[float],
    frames: Frames,
    placed: PlacedLinks,
    stamp: Time,
) -> None:
    """Put an answer and its wrench (6,) about the base into a `cablesense_msgs/ForceEstimate`."""
    contact = answer.contact
    segment = answer.contact.segment
    message.header.frame_id = frames.segment(segment) if segment else frames.base
    message.header.stamp = stamp
    message.state = getattr(message, answer.force.name)
    message.segment = segment
    message.moment_only = bool(segment and not contact.magnitude_n)
    message.probability = float(answer.probabilities[segment]) if answer.probabilities else nan
    for numbers, put in (
        (placed.wrench(segment, answer.wrench("nan") or UNKNOWN_WRENCH), message.wrench),
        (in_base, message.wrench_base),
    ):
        put.force.x, put.force.y, put.force.z, put.torque.x, put.torque.y, put.torque.z = numbers
    lower, upper = answer.bounds or (None, None)
    message.force_low = lower.magnitude_n if lower else nan
    message.force_high = upper.magnitude_n if upper else nan
    point = message.contact_point
    point.x, point.y, point.z = (
        placed.point(segment, contact.contact_m) if segment else (nan, nan, nan)
    )
    message.place_low, message.place_high = answer.region_m or (nan, nan)
    place = answer.estimate.place if segment and answer.estimate else None
    message.covariance = array("d", place.covariance.ravel().tolist() if place else [nan] * 16)


def contact_markers(
    frames: Frames,
    placed: PlacedLinks,
    most: int,
    contacts: Sequence[Contact],
    region_m: tuple[float, float] | None,
    stamp: Time,
) -> MarkerArray:
    """For each contact an arrow that ends at its point, as a push does, and a sphere there.

    A band along the axis shows where a single contact lies with a probability of 95 %. Up to
    `most` contacts are shown; markers of those that are gone are deleted.
    """

    def marker(
        namespace: str, number: int, kind: int, contact: Contact, size_m: Sequence[float]
    ) -> Marker:
        message = Marker(ns=namespace, id=number, type=kind)
        shown = contact.segment > 0
        message.header.frame_id = frames.segment(contact.segment) if shown else frames.base
        message.header.stamp = stamp
        message.action = Marker.ADD if shown else Marker.DELETE
        if shown:
            at = placed.point(contact.segment, 0.0)
            turn = placed.quaternion(contact.segment)
            message.pose.position = Point(**dict(zip("xyz", at, strict=True)))
            message.pose.orientation = Quaternion(**dict(zip("xyzw", turn, strict=True)))
        else:
            message.pose.orientation.w = 1.0
        message.color.r, message.color.g, message.color.b, message.color.a = _COLOUR
        message.scale.x, message.scale.y, message.scale.z = size_m
        return message

    markers = []
    for n in range(most):
        contact = contacts[n] if n < len(contacts) else NO_CONTACT
        arrow = marker("contact", 2 * n, Marker.ARROW, contact, _ARROW_DIAMETERS_M)
        sphere = marker("contact", 2 * n + 1, Marker.SPHERE, contact, [_SPHERE_DIAMETER_M] * 3)
        (y, z) = contact.direction
        length_m = ARROW_M_PER_N * contact.magnitude_n
        tip = Point(x=contact.contact_m)
        at = placed.point(contact.segment, contact.contact_m) if contact.segment else (0.0,) * 3
        sphere.pose.position = Point(**dict(zip("xyz", at, strict=True)))
        arrow.points = [Point(x=tip.x, y=-length_m * y, z=-length_m * z), tip]
        markers += [arrow, sphere]
    of_region = contacts[0] if contacts and region_m is not None else NO_CONTACT
    low_m, high_m = region_m or (0.0, 0.0)
    size_m = max(high_m - low_m, _SHORTEST_BAND_M), _BAND_WIDTH_M, _BAND_WIDTH_M
    band = marker("region", 0, Marker.CUBE, of_region, size_m)
    middle_m = 0.5 * (low_m + high_m)
    at = placed.point(of_region.segment, middle_m) if of_region.segment else (0.0,) * 3
    band.pose.position = Point(**dict(zip("xyz", at, strict=True)))
    band.color.a = _BAND_OPACITY
    return MarkerArray(markers=[*markers, band])


def _time(stamp_ns: int) -> Time:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return Time(sec=seconds, nanosec=nanoseconds)
