"""The estimator's settings that benchmarks and tests share."""

from typing import Any

from cablesense_online.settings import EstimationSettings
from cablesense_ros.default_settings import node_settings


def estimation_settings(**changes: Any) -> EstimationSettings:
    """As the node's, but for a tare of few readings, and joints that any command moves."""
    plain = {
        "tare_samples": 5,
        "tare_deviation_n": 0.0,
        "joint_speed_rad_s": 0.35,
        "still_rad": 0.0,
        "follow_rad_s": 0.0,
    }
    return node_settings(**plain | changes)
