"""The estimator's settings that benchmarks and tests share."""

from typing import Any

from cablesense_online.settings import EstimationSettings


def estimation_settings(**changes: Any) -> EstimationSettings:
    """As the node's, but for a tare of few readings, and joints that any command moves."""
    plain = {
        "contact_threshold": 0.5,
        "stale_after_s": 0.2,
        "slack_below_n": 1.0,
        "tare_samples": 5,
        "tare_steady_n": 1.0,
        "auto_tare": True,
        "joint_speed_rad_s": 0.35,
        "settle_s": 0.5,
    }
    return EstimationSettings(**plain | changes)
