"""What the page shows at one moment: plain values, wherever they came from.

True against estimated contacts: the error of one moment, and the error so far.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from cablesense_base.arrays import Array


@dataclass(frozen=True)
class Contact:
    """A single force on the arm, true or estimated.

    Attributes:
        segment: 1 … N.
        angle_deg: contact angle at the commanded pose, from the segment's +z towards its +y.
        magnitude_n: newtons.
        force_base_n: (3,) the same force in base axes.
    """

    segment: int
    angle_deg: float
    magnitude_n: float
    force_base_n: Array


class Level(Enum):
    """How far the estimate can be trusted."""

    OK = "ok"
    WARNING = "warning"
    ERROR = "error"
    STALE = "stale"


@dataclass(frozen=True)
class Status:
    """The estimator's own word about itself: level, headline, and what a person should know."""

    level: Level
    headline: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Snapshot:
    """One moment of the arm.

    Attributes:
        time_s: of the newest tensions, any steady clock.
        joint_angles_rad: (2N,) measured or commanded.
        tensions_n: (M,) or None before the first arrives.
        true: the load that is really applied, where it is known.
        estimate: the estimated contact; None when nothing touches or nothing is known.
        probabilities: (N + 1,) of no contact and of each segment, or None.
        status: of the estimator.
    """

    time_s: float
    joint_angles_rad: Array
    tensions_n: Array | None
    true: Contact | None
    estimate: Contact | None
    probabilities: Array | None
    status: Status


SETTLING_S = 1.0
"""A comparison waits this long after a change: the arm swings and the estimate follows."""
STILL_N = 0.01
STILL_RAD = 0.003
"""Load and pose that change by less stand still."""


def angle_error_deg(a_deg: float, b_deg: float) -> float:
    """The smaller turn between two angles, 0 … 180 degrees."""
    return abs((a_deg - b_deg + 180.0) % 360.0 - 180.0)


@dataclass(frozen=True)
class Errors:
    """Mean errors over the moments compared so far.

    Attributes:
        count: moments compared.
        segment_right: share of them, 0 … 1, with the right segment (or rightly none).
        angle_mae_deg: over those with the right segment; None before the first.
        magnitude_mae_n: likewise.
    """

    count: int
    segment_right: float | None
    angle_mae_deg: float | None
    magnitude_mae_n: float | None


class Score:
    """Adds up errors while the true load stays put."""

    def __init__(self, settling_s: float = SETTLING_S) -> None:
        self._settling_s = settling_s
        self._still: Snapshot | None = None
        self._still_since_s = 0.0
        self.reset()

    def reset(self) -> None:
        """Forgets every comparison."""
        self._count = self._right = self._contacts = 0
        self._angle_sum_deg = self._magnitude_sum_n = 0.0

    def add(self, snapshot: Snapshot) -> bool:
        """Compares one moment; says whether it counted: load and pose must have stood still."""
        if snapshot.status.level is Level.STALE:
            return False
        if self._changed(snapshot):
            self._still_since_s = snapshot.time_s
        if snapshot.time_s - self._still_since_s < self._settling_s:
            return False
        true, estimate = snapshot.true, snapshot.estimate
        self._count += 1
        true_segment = true.segment if true is not None else 0
        estimated_segment = estimate.segment if estimate is not None else 0
        if true_segment == estimated_segment:
            self._right += 1
            if true is not None and estimate is not None:
                self._contacts += 1
                self._angle_sum_deg += angle_error_deg(true.angle_deg, estimate.angle_deg)
                self._magnitude_sum_n += abs(true.magnitude_n - estimate.magnitude_n)
        return True

    def _changed(self, snapshot: Snapshot) -> bool:
        """Whether load or pose differ from those since which the arm has stood still."""
        still, true = self._still, snapshot.true
        if still is not None and (still.true is None) == (true is None):
            force_moved = 0.0
            if still.true is not None and true is not None:
                force_moved = float(np.abs(still.true.force_base_n - true.force_base_n).max())
            pose_moved = float(np.abs(still.joint_angles_rad - snapshot.joint_angles_rad).max())
            if force_moved < STILL_N and pose_moved < STILL_RAD:
                return False
        self._still = snapshot
        return True

    @property
    def errors(self) -> Errors:
        """The errors so far."""
        return Errors(
            self._count,
            self._right / self._count if self._count else None,
            self._angle_sum_deg / self._contacts if self._contacts else None,
            self._magnitude_sum_n / self._contacts if self._contacts else None,
        )
