"""The contract's quality of service as rclpy profiles, all open to `qos_overrides` parameters."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from cablesense_msgs_py.qos import Qos


def qos_profile(qos: Qos) -> QoSProfile:
    """A new profile: rclpy writes overrides into the one it is given."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=(
            DurabilityPolicy.TRANSIENT_LOCAL if qos.transient_local else DurabilityPolicy.VOLATILE
        ),
    )


def overridable() -> QoSOverridingOptions:
    """History, depth and reliability may be overridden by parameters.

    Their names are `qos_overrides.<topic>.<publisher|subscription>.<policy>`.
    """
    return QoSOverridingOptions.with_default_policies()
