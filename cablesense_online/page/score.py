"""The errors of the estimate, as the page adds them up over instants at rest."""

from __future__ import annotations

from itertools import zip_longest
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import ForceState
from cablesense_online.felt_contact import felt_part
from cablesense_online.page.snapshot import Snapshot

SETTLING_S = 1.0
"""A comparison waits this long after a change: the arm swings and the estimate follows."""
_STILL_N = 0.01
"""Change of a load below which it stands still."""
_STILL_M = 0.001
"""Change of its place below which it stands still."""
_STILL_RAD = 0.003
"""Change of a joint angle below which the pose stands still."""
GUESS_DEG = 90.0
"""Direction error of a contact that was missed, or found on another segment: a guess's mean."""


def angle_error_deg(a_deg: float, b_deg: float) -> float:
    """The smaller turn between two angles, 0 … 180 degrees."""
    return abs((a_deg - b_deg + 180.0) % 360.0 - 180.0)


class Errors(NamedTuple):
    """Mean errors over the instants at rest with an answer; None before the first.

    Attributes:
        pushed: number of instants at which something pushed.
        untouched: number of instants at which nothing did.
        unanswered: share, 0 … 1, of the instants at rest at which the estimator gave no answer.
        segment_right: share, 0 … 1, of the pushed instants with the right segments.
        false_contacts: share, 0 … 1, of the untouched instants with a contact.
        place_mae_m: over contacts on the right segment whose place is estimated.
        angle_mae_deg: over contacts; `GUESS_DEG` for a miss.
        magnitude_mae_n: over contacts, true or estimated, but those of which the moment alone is
            known. The error of a contact on a wrong segment is the greater of the true and the
            estimated force.
    """

    pushed: int
    untouched: int
    unanswered: float | None
    segment_right: float | None
    false_contacts: float | None
    place_mae_m: float | None
    angle_mae_deg: float | None
    magnitude_mae_n: float | None


class Score:
    """Adds up errors while load and pose stay put."""

    def __init__(self, felt_across: Array, settling_s: float = SETTLING_S) -> None:
        """`felt_across` (N, 2, 2) says which part of a force on each link is to be estimated."""
        self._felt_across = felt_across
        self._settling_s = settling_s
        self._still: Array | None = None
        self._still_since_s = 0.0
        self.reset()

    def reset(self) -> None:
        """Discards every comparison."""
        self._pushed = 0
        self._untouched = 0
        self._right = 0
        self._false = 0
        self._unanswered = 0
        # number and sum of errors
        self._aside = np.zeros(2)
        self._turned = np.zeros(2)
        self._off = np.zeros(2)

    def add(self, snapshot: Snapshot) -> None:
        """Takes one instant, which counts if load and pose have stood still."""
        self._watch(snapshot)
        if snapshot.time_s - self._still_since_s < self._settling_s:
            return
        if snapshot.readings is None or snapshot.state is ForceState.MOVING:
            return
        if not snapshot.state.known and not snapshot.estimated:
            self._unanswered += 1
            return
        true = {
            contact.segment: felt_part(contact, self._felt_across[contact.segment - 1])
            for contact in snapshot.true
        }
        estimated = {contact.segment: contact for contact in snapshot.estimated}
        matched = true.keys() & estimated.keys()
        angles_deg = [(true[n].angle_deg, estimated[n].angle_deg) for n in matched]
        seen = set(estimated)
        by_moment = snapshot.known_by_moment
        if by_moment is not None:
            seen.add(by_moment.segment)
        if true:
            self._pushed += 1
            self._right += true.keys() == seen
        else:
            self._untouched += 1
            self._false += bool(seen)
        if by_moment is not None and by_moment.segment in true:
            # there is no place and no force to compare
            true_deg = true.pop(by_moment.segment).angle_deg
            angles_deg.append((true_deg, by_moment.angle_deg))
        missed_n = [true[n].magnitude_n for n in true.keys() - matched]
        ghosts_n = [estimated[n].magnitude_n for n in estimated.keys() - matched]
        aside_m = [abs(true[n].contact_m - estimated[n].contact_m) for n in matched]
        turned_deg = [angle_error_deg(*pair) for pair in angles_deg]
        turned_deg += [GUESS_DEG] * len(missed_n)
        off_n = [abs(true[n].magnitude_n - estimated[n].magnitude_n) for n in matched]
        off_n += map(max, zip_longest(missed_n, ghosts_n, fillvalue=0.0))
        self._aside += len(aside_m), sum(aside_m)
        self._turned += len(turned_deg), sum(turned_deg)
        self._off += len(off_n), sum(off_n)

    def _watch(self, snapshot: Snapshot) -> None:
        """Notes since when load and pose have stood still."""
        loads = np.zeros((len(self._felt_across), 4))
        for contact in snapshot.true:
            force = np.array(contact.wrench[:3]) / _STILL_N
            loads[contact.segment - 1] = *force, contact.contact_m / _STILL_M
        now = np.append(loads, snapshot.pose / _STILL_RAD)
        if self._still is None or np.abs(now - self._still).max() >= 1.0:
            self._still = now
            self._still_since_s = snapshot.time_s

    @property
    def errors(self) -> Errors:
        """The errors up to now."""

        def mean(count: float, total: float) -> float | None:
            return total / count if count else None

        at_rest = self._pushed + self._untouched + self._unanswered
        return Errors(
            self._pushed,
            self._untouched,
            mean(at_rest, self._unanswered),
            mean(self._pushed, self._right),
            mean(self._untouched, self._false),
            mean(*self._aside),
            mean(*self._turned),
            mean(*self._off),
        )
