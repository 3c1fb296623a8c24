"""What sequences of motion and contact are drawn from."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from typing import Any

from cablesense_training.data.errors import DatasetError

LONGEST_S = 3600.0


@dataclass(frozen=True, kw_only=True)
class MotionProtocol:
    """Options of a run; refused with a `DatasetError` when out of range.

    Attributes:
        sequences: number of sequences, independent of each other.
        duration_s: of each.
        tick_s: time from sample to sample.
        pose_range_deg: joint angles are commanded within plus or minus this.
        joint_speed_deg_s: peak speed of a move, as the parameter of that name of sim and
            estimator.
        force_high_n: strongest contact.
        tare_samples: readings averaged into the unloaded state, which is taken once, at the start.
        noise: whether the sensors' noise and step act.
    """

    sequences: int = 256
    duration_s: float = 30.0
    tick_s: float = 0.02
    pose_range_deg: float = 10.0
    joint_speed_deg_s: float = 20.0
    force_high_n: float = 100.0
    tare_samples: int = 50
    noise: bool = True

    def __post_init__(self) -> None:
        _within("sequences", self.sequences, 1, 1_000_000)
        _within("tick_s", self.tick_s, 1e-3, 1.0)
        _within("duration_s", self.duration_s, self.tick_s, LONGEST_S)
        _within("pose_range_deg", self.pose_range_deg, 0.0, 45.0)
        _within("joint_speed_deg_s", self.joint_speed_deg_s, 0.1, 1000.0)
        _within("force_high_n", self.force_high_n, 0.1, 10_000.0)
        _within("tare_samples", self.tare_samples, 1, 10_000)

    @property
    def ticks(self) -> int:
        """Samples in a sequence."""
        return max(1, round(self.duration_s / self.tick_s))

    def options(self) -> dict[str, Any]:
        """As plain values."""
        return asdict(self)


def _within(name: str, value: float, low: float, high: float) -> None:
    if not math.isfinite(value) or not low <= value <= high:
        raise DatasetError(f"{name} = {value!r}: must be a number from {low:,g} to {high:,g}")


OPTION_NAMES = tuple(field.name for field in fields(MotionProtocol))
