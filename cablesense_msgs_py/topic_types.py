"""Type and quality of service of every topic of the contract, for who records or replays it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from cablesense_msgs_py import topics
from cablesense_msgs_py.qos import COMMAND, JOURNAL, LATCHED, PUBLISHER, SENSOR, Qos

_HEARD: Final = Qos(depth=2000, reliable=True)

ESTIMATOR: Final = "estimator"
"""The estimator node's name, which `~` stands for."""

JOINT_STATE: Final = "sensor_msgs/msg/JointState"
WRENCH: Final = "geometry_msgs/msg/WrenchStamped"
NUMBER: Final = "std_msgs/msg/Int32"


@dataclass(frozen=True)
class TopicType:
    """One topic: its message's full name, how it is offered, and how it is listened to."""

    kind: str
    offered: Qos
    heard: Qos = _HEARD


INPUTS: Final = {
    topics.CABLE_TENSIONS: TopicType(JOINT_STATE, PUBLISHER, SENSOR),
    topics.JOINT_COMMANDS: TopicType(JOINT_STATE, COMMAND, COMMAND),
    topics.APPLIED_WRENCH: TopicType(WRENCH, COMMAND, COMMAND),
    topics.TRIAL: TopicType(NUMBER, COMMAND, COMMAND),
}
"""What a diagnosis of the arm needs."""

CONTRACT: Final = {
    **INPUTS,
    topics.JOINT_STATES: TopicType(JOINT_STATE, PUBLISHER),
    topics.ROBOT_DESCRIPTION: TopicType("std_msgs/msg/String", LATCHED, LATCHED),
    topics.DIAGNOSTICS: TopicType("diagnostic_msgs/msg/DiagnosticArray", PUBLISHER),
    topics.WRENCH: TopicType(WRENCH, PUBLISHER),
    topics.CONTACT_POINT: TopicType("geometry_msgs/msg/PointStamped", PUBLISHER),
    topics.FORCE_DIRECTION: TopicType("geometry_msgs/msg/Vector3Stamped", PUBLISHER),
    topics.CONTACT_PROBABILITIES: TopicType("std_msgs/msg/Float64MultiArray", PUBLISHER),
    topics.MARKERS: TopicType("visualization_msgs/msg/MarkerArray", PUBLISHER),
    topics.JOURNAL: TopicType("diagnostic_msgs/msg/DiagnosticArray", JOURNAL, JOURNAL),
    "/tf": TopicType("tf2_msgs/msg/TFMessage", PUBLISHER),
    "/tf_static": TopicType("tf2_msgs/msg/TFMessage", LATCHED, Qos(100, True, True)),
}
"""Everything: inputs, the estimator's outputs, what shows the arm; `/tf` where its type is."""


def resolved(topic: str, namespace: str = "/") -> str:
    """The full name of a topic of the contract in a namespace, as ROS would resolve it."""
    if topic.startswith("/"):
        return topic
    inside = topic.replace("~", ESTIMATOR, 1) if topic.startswith("~/") else topic
    return f"/{namespace.strip('/')}/{inside}".replace("//", "/")


def of_contract(name: str) -> str | None:
    """The topic of the contract that a full name stands for, in whatever namespace; or none.

    `/arm/cable_tensions` is `cable_tensions`, and `/arm/estimator/wrench` is `~/wrench`.
    """
    *_, node, last = ["", "", *name.split("/")]
    for topic in (name, f"~/{last}" if node == ESTIMATOR else "", last):
        if topic in CONTRACT:
            return topic
    return "/diagnostics" if last == "diagnostics" else None
