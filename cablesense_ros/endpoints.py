"""Topics of the contract in rclpy's terms: quality of service, message classes, names."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions

from cablesense_msgs_py.qos import Qos


def qos_profile(qos: Qos) -> QoSProfile:
    """A new profile: rclpy writes overrides into the one it is given."""
    profile = QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=(
            DurabilityPolicy.TRANSIENT_LOCAL if qos.transient_local else DurabilityPolicy.VOLATILE
        ),
    )
    if qos.lease_s:
        profile.liveliness = LivelinessPolicy.AUTOMATIC
        profile.liveliness_lease_duration = Duration(seconds=qos.lease_s)
    return profile


def overridable(qos: Qos) -> dict[str, Any]:
    """Keywords of a publisher or subscription: this quality, open to parameters.

    History, depth and reliability may be overridden by parameters that are named
    `qos_overrides.<topic>.<publisher|subscription>.<policy>`.
    """
    return {
        "qos_profile": qos_profile(qos),
        "qos_overriding_options": QoSOverridingOptions.with_default_policies(),
    }


def of_node(node_name: str, topic: str) -> str:
    """A private topic (`~/…`) of a node, as another node names it."""
    return topic.replace("~", node_name, 1)


def message_class(kind: str) -> type | None:
    """The class of `sensor_msgs/msg/JointState` and the like; none where it is not installed."""
    package, _, name = kind.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), name, None)
    except ModuleNotFoundError:
        return None
