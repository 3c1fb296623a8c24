"""How good the estimates were so far: true against estimated contacts, the arm at rest."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from cablesense_msgs_py.messages import ForceState
from cablesense_online.page.live_arm import ShownContact, Snapshot

SETTLING_S = 1.0
"""A comparison waits this long after a change: the arm swings and the estimate follows."""
STILL_N = 0.01
STILL_RAD = 0.003
"""Load and pose that change by less stand still."""
GUESS_DEG = 90.0
"""Direction error of a contact that was missed, or found on another segment: a guess's mean."""


def angle_error_deg(a_deg: float, b_deg: float) -> float:
    """The smaller turn between two angles, 0 … 180 degrees."""
    return abs((a_deg - b_deg + 180.0) % 360.0 - 180.0)


@dataclass(frozen=True)
class Errors:
    """Mean errors over the `count` moments with an answer so far; None before the first.

    Attributes:
        count: of moments that were compared.
        unanswered: share, 0 … 1, of the moments at rest in which the estimator gave no answer.
        segment_right: share, 0 … 1, of moments with the right segments, or rightly none.
        angle_mae_deg: over contacts; `GUESS_DEG` for a miss.
        magnitude_mae_n: over contacts, true or estimated. Where a true and an estimated one are on
            different segments, all of the greater force is the error.
    """

    count: int
    unanswered: float | None
    segment_right: float | None
    angle_mae_deg: float | None
    magnitude_mae_n: float | None


def _by_segment(snapshot: Snapshot) -> list[ShownContact]:
    return sorted(snapshot.all_true, key=lambda contact: contact.segment)


def _segments(snapshot: Snapshot) -> list[int]:
    return [contact.segment for contact in _by_segment(snapshot)]


class Score:
    """Adds up errors while load and pose stay put."""

    def __init__(self, settling_s: float = SETTLING_S) -> None:
        self._settling_s = settling_s
        self._still: Snapshot | None = None
        self._still_since_s = 0.0
        self.reset()

    def reset(self) -> None:
        """Discards every comparison."""
        self._count = self._right = self._unanswered = 0
        self._touched, self._turned_deg = 0, 0.0
        self._pressed, self._off_n = 0, 0.0

    def add(self, snapshot: Snapshot) -> bool:
        """Takes one moment; gives whether it counted: load and pose must have stood still."""
        if self._changed(snapshot):
            self._still_since_s = snapshot.time_s
        if snapshot.time_s - self._still_since_s < self._settling_s:
            return False
        if snapshot.tensions_n is None or snapshot.state is ForceState.MOVING:
            return False
        if not snapshot.state.known and snapshot.estimate is None:
            self._unanswered += 1
            return True
        true = {each.segment: each for each in snapshot.all_true}
        estimated = {each.segment: each for each in snapshot.all_estimated}
        self._count += 1
        self._right += true.keys() == estimated.keys()
        self._touched += len(true)
        for segment in true.keys() & estimated.keys():
            right, answer = true.pop(segment), estimated.pop(segment)
            self._pressed += 1
            self._turned_deg += angle_error_deg(right.angle_deg, answer.angle_deg)
            self._off_n += abs(right.magnitude_n - answer.magnitude_n)
        self._turned_deg += GUESS_DEG * len(true)
        for pair in zip_longest(true.values(), estimated.values()):
            self._pressed += 1
            self._off_n += max(each.magnitude_n for each in pair if each is not None)
        return True

    def _changed(self, snapshot: Snapshot) -> bool:
        """Whether load or pose differ from those since which the arm has stood still."""
        still = self._still
        if still is not None and _segments(still) == _segments(snapshot):
            force_moved = max(
                (
                    float(np.abs(before.force_base_n - now.force_base_n).max())
                    for before, now in zip(_by_segment(still), _by_segment(snapshot), strict=True)
                ),
                default=0.0,
            )
            pose_moved = float(np.abs(still.joint_angles_rad - snapshot.joint_angles_rad).max())
            if force_moved < STILL_N and pose_moved < STILL_RAD:
                return False
        self._still = snapshot
        return True

    @property
    def errors(self) -> Errors:
        """The errors so far."""

        def share(total: float, count: int) -> float | None:
            return total / count if count else None

        return Errors(
            self._count,
            share(self._unanswered, self._count + self._unanswered),
            share(self._right, self._count),
            share(self._turned_deg, self._touched),
            share(self._off_n, self._pressed),
        )
