"""Quality of service by purpose, and the message type of every topic, without rclpy."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from cablesense_msgs_py import topics


@dataclass(frozen=True)
class Qos:
    """The quality that a publisher offers or a subscriber asks for; history is keep-last `depth`.

    `lease_s`: a publisher whose process shows no sign of life for so long counts as dead with
    those subscribers that ask for a lease as well (liveliness, automatic); 0 for none.
    """

    depth: int
    reliable: bool
    transient_local: bool = False
    lease_s: float = 0.0


PUBLISHER_QOS: Final = Qos(depth=10, reliable=True)
"""Every output: the system default, so that reliable and best-effort subscribers both match."""
WRENCH_QOS: Final = Qos(depth=10, reliable=True, lease_s=0.05)
"""The estimator's answer: as every output, and a subscriber that asks for a liveliness lease of
0.05 s or more is notified by its own middleware when the estimator's process has died."""
SENSOR_QOS: Final = Qos(depth=100, reliable=False)
"""High-rate input: sensor data, best effort. A tenth of a second at 1 kHz, so that a short pause
of a process loses no sample, and one that cannot keep up answers no stale ones: those are dropped
first. ROS's own sensor profile keeps five."""
COMMAND_QOS: Final = Qos(depth=10, reliable=True)
"""Commands and loads: rare, and none may be lost."""
LATCHED_QOS: Final = Qos(depth=1, reliable=True, transient_local=True)
"""For late subscribers, too: the robot description."""
_RECORDER_QOS: Final = Qos(depth=2000, reliable=True)
_ON_SEGMENT: Final = re.compile(r"/estimator/wrenches/segment_([1-9][0-9]{0,3})$")
JOINT_STATE_TYPE: Final = "sensor_msgs/msg/JointState"
WRENCH_TYPE: Final = "geometry_msgs/msg/WrenchStamped"
NUMBER_TYPE: Final = "std_msgs/msg/Int32"
BYTES_TYPE: Final = "std_msgs/msg/UInt8MultiArray"
_DIAGNOSTICS_TYPE: Final = "diagnostic_msgs/msg/DiagnosticArray"


@dataclass(frozen=True)
class TopicType:
    """One topic: its message's full name, QoS offered, and QoS requested by a recorder."""

    kind: str
    offered: Qos
    requested: Qos = _RECORDER_QOS


INPUTS: Final = {
    topics.CABLE_TENSIONS: TopicType(JOINT_STATE_TYPE, PUBLISHER_QOS, SENSOR_QOS),
    topics.JOINT_COMMANDS: TopicType(JOINT_STATE_TYPE, COMMAND_QOS, COMMAND_QOS),
    topics.CABLE_OFFSETS: TopicType(JOINT_STATE_TYPE, COMMAND_QOS, COMMAND_QOS),
    topics.APPLIED_WRENCH: TopicType(WRENCH_TYPE, COMMAND_QOS, COMMAND_QOS),
    topics.TRIAL: TopicType(NUMBER_TYPE, COMMAND_QOS, COMMAND_QOS),
}
"""The topics that a diagnosis of the arm reads; it needs all but the offsets and the trials."""

RECORDED_TOPICS: Final = {
    **INPUTS,
    topics.JOINT_TRAJECTORY: TopicType(
        "trajectory_msgs/msg/JointTrajectory", COMMAND_QOS, COMMAND_QOS
    ),
    topics.JOINT_STATES: TopicType(JOINT_STATE_TYPE, PUBLISHER_QOS),
    topics.ROBOT_DESCRIPTION: TopicType("std_msgs/msg/String", LATCHED_QOS, LATCHED_QOS),
    topics.DIAGNOSTICS: TopicType(_DIAGNOSTICS_TYPE, PUBLISHER_QOS),
    topics.WRENCH: TopicType(WRENCH_TYPE, WRENCH_QOS),
    topics.STATUS: TopicType(_DIAGNOSTICS_TYPE, PUBLISHER_QOS),
    topics.WRENCH_LOWER: TopicType(WRENCH_TYPE, PUBLISHER_QOS),
    topics.WRENCH_UPPER: TopicType(WRENCH_TYPE, PUBLISHER_QOS),
    topics.WRENCH_BASE: TopicType(WRENCH_TYPE, PUBLISHER_QOS),
    topics.JOINT_TORQUES: TopicType(JOINT_STATE_TYPE, PUBLISHER_QOS),
    topics.SEGMENT_WRENCHES: TopicType(WRENCH_TYPE, PUBLISHER_QOS),
    topics.CONTACT_POINT: TopicType("geometry_msgs/msg/PointStamped", PUBLISHER_QOS),
    topics.CONTACT_REGION: TopicType("geometry_msgs/msg/PolygonStamped", PUBLISHER_QOS),
    topics.CONTACT_POSE: TopicType("geometry_msgs/msg/PoseWithCovarianceStamped", PUBLISHER_QOS),
    topics.CONTACT_COVARIANCE: TopicType("std_msgs/msg/Float64MultiArray", PUBLISHER_QOS),
    topics.FORCE_DIRECTION: TopicType("geometry_msgs/msg/Vector3Stamped", PUBLISHER_QOS),
    topics.CONTACT_PROBABILITIES: TopicType("std_msgs/msg/Float64MultiArray", PUBLISHER_QOS),
    topics.MARKERS: TopicType("visualization_msgs/msg/MarkerArray", PUBLISHER_QOS),
    topics.CALIBRATION: TopicType(BYTES_TYPE, LATCHED_QOS, LATCHED_QOS),
    topics.CALIBRATION_USED: TopicType(BYTES_TYPE, LATCHED_QOS, LATCHED_QOS),
    "/tf": TopicType("tf2_msgs/msg/TFMessage", PUBLISHER_QOS),
    "/tf_static": TopicType("tf2_msgs/msg/TFMessage", LATCHED_QOS, Qos(100, True, True)),
}
"""What a run's recording has: inputs, the estimator's outputs, what shows the arm; `/tf` where its
type is. `record` subscribes to each. Left out are `ESTIMATE`, which repeats other topics, and
`SIMULATED_TENSIONS`, which come back as `CABLE_TENSIONS`."""


def resolved(topic: str, namespace: str = "/") -> str:
    """The full name of a topic of the contract in a namespace, as ROS resolves it."""
    if topic.startswith("/"):
        return topic
    inside = topic.replace("~/", "estimator/", 1)
    return f"/{namespace.strip('/')}/{inside}".replace("//", "/")


def segment_of(name: str) -> int:
    """The segment that a full name of `SEGMENT_WRENCHES` is of; 0 for other topics."""
    match = _ON_SEGMENT.search(name)
    return int(match.group(1)) if match else 0


def recorded_topic(name: str) -> str | None:
    """The recorded topic that has a full name, in any namespace; None for other names.

    `/arm/estimator/wrench` is `~/wrench`, and that of any segment `SEGMENT_WRENCHES`.
    """
    if segment_of(name):
        return topics.SEGMENT_WRENCHES
    *_, node, last = ["", "", *name.split("/")]
    for topic in (name, f"~/{last}" if node == "estimator" else "", last):
        if topic in RECORDED_TOPICS:
            return topic
    return "/diagnostics" if last == "diagnostics" else None
