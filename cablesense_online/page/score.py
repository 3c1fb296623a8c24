"""Mean errors of the estimates: true against estimated contacts, the arm at rest."""

from __future__ import annotations

from itertools import zip_longest
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import ForceState
from cablesense_online.page.snapshot import Snapshot

SETTLING_S = 1.0
"""A comparison waits this long after a change: the arm swings and the estimate follows."""
STILL_N = 0.01
STILL_M = 0.001
STILL_RAD = 0.003
"""Load, its place and pose that change by less stand still."""
GUESS_DEG = 90.0
"""Direction error of a contact that was missed, or found on another segment: a guess's mean."""


def angle_error_deg(a_deg: float, b_deg: float) -> float:
    """The smaller turn between two angles, 0 … 180 degrees."""
    return abs((a_deg - b_deg + 180.0) % 360.0 - 180.0)


class Errors(NamedTuple):
    """Mean errors over the moments `compared` with an answer; None before the first.

    Attributes:
        compared: number of moments.
        unanswered: share, 0 … 1, of the moments at rest in which the estimator gave no answer.
        segment_right: share, 0 … 1, of moments with the right segments, or rightly none.
        place_mae_m: over contacts on the right segment whose place is estimated.
        angle_mae_deg: over contacts; `GUESS_DEG` for a miss.
        magnitude_mae_n: over contacts, true or estimated, but those of which the moment alone is
            known. The error of a contact on a wrong segment is the greater of the true and the
            estimated force.
    """

    compared: int
    unanswered: float | None
    segment_right: float | None
    place_mae_m: float | None
    angle_mae_deg: float | None
    magnitude_mae_n: float | None


class Score:
    """Adds up errors while load and pose stay put."""

    def __init__(self, settling_s: float = SETTLING_S) -> None:
        self._settling_s = settling_s
        self._still: Array | None = None
        self._still_since_s = 0.0
        self.reset()

    def reset(self) -> None:
        """Discards every comparison."""
        self._count = self._right = self._unanswered = 0
        # number and sum of errors
        self._aside, self._turned, self._off = np.zeros(2), np.zeros(2), np.zeros(2)

    def add(self, snapshot: Snapshot) -> bool:
        """Takes one moment; gives whether it counted: load and pose must have stood still."""
        self._watch(snapshot)
        if snapshot.time_s - self._still_since_s < self._settling_s:
            return False
        if snapshot.tensions_n is None or snapshot.state is ForceState.MOVING:
            return False
        if not snapshot.state.known and not snapshot.estimated:
            self._unanswered += 1
            return True
        true = {each.segment: each for each in snapshot.true}
        found = {each.segment: each for each in snapshot.estimated}
        both = true.keys() & found.keys()
        angles_deg = [(true[n].angle_deg, found[n].angle_deg) for n in both]
        seen, moment = set(found), snapshot.moment
        if moment is not None:
            seen.add(moment.segment)
        self._right += true.keys() == seen
        if moment is not None and moment.segment in true:  # no place and no force to compare
            angles_deg.append((true.pop(moment.segment).angle_deg, moment.angle_deg))
        missed_n = [true[n].magnitude_n for n in true.keys() - both]
        ghosts_n = [found[n].magnitude_n for n in found.keys() - both]
        aside_m = [abs(true[n].contact_m - found[n].contact_m) for n in both]
        turned_deg = [angle_error_deg(*pair) for pair in angles_deg]
        turned_deg += [GUESS_DEG] * len(missed_n)
        off_n = [abs(true[n].magnitude_n - found[n].magnitude_n) for n in both]
        off_n += map(max, zip_longest(missed_n, ghosts_n, fillvalue=0.0))
        self._count += 1
        self._aside += len(aside_m), sum(aside_m)
        self._turned += len(turned_deg), sum(turned_deg)
        self._off += len(off_n), sum(off_n)
        return True

    def _watch(self, snapshot: Snapshot) -> None:
        """Notes since when load and pose have stood still."""
        loads = np.zeros((len(snapshot.joint_angles_rad) // 2, 4))
        for contact in snapshot.true:
            force = contact.force_base_n / STILL_N
            loads[contact.segment - 1] = *force, contact.contact_m / STILL_M
        now = np.append(loads, snapshot.joint_angles_rad / STILL_RAD)
        if self._still is None or np.abs(now - self._still).max() >= 1.0:
            self._still, self._still_since_s = now, snapshot.time_s

    @property
    def errors(self) -> Errors:
        """The errors up to now."""

        def mean(count: float, total: float) -> float | None:
            return total / count if count else None

        return Errors(
            self._count,
            mean(self._count + self._unanswered, self._unanswered),
            mean(self._count, self._right),
            mean(*self._aside),
            mean(*self._turned),
            mean(*self._off),
        )
