"""What the page shows at one moment: plain values, wherever they came from."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
