"""The contract's quality of service as rclpy profiles, all open to `qos_overrides` parameters."""

from __future__ import annotations

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


def overridable() -> QoSOverridingOptions:
    """History, depth and reliability may be overridden by parameters.

    Their names are `qos_overrides.<topic>.<publisher|subscription>.<policy>`.
    """
    return QoSOverridingOptions.with_default_policies()
