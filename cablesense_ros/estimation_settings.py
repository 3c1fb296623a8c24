"""What the estimator is told beside its arm and its model."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class EstimationSettings:
    """As the node's parameters of the same names say."""

    contact_threshold: float
    stale_after_s: float
    slack_below_n: float
    tare_samples: int
    tare_steady_n: float
    auto_tare: bool
    joint_speed_rad_s: float
    settle_s: float
