"""What is stated of a touched arm against what acts on it: which vouched statements are wrong.

A statement is vouched for if its state is `contact` or `moment`. It is wrong if the lateral force
is off by more than 5 N and a fifth, or the segment is another one; next to a joint the neighbour's
end is the same place. Where the moment alone is stated, it is judged over the segment's length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_plants.arm.built import Push

WRONG_N = 5.0
WRONG_SHARE = 0.2
SAME_PLACE_M = 0.02
"""Next to a joint the neighbour's end is the same place."""


class Stated(NamedTuple):
    """A vouched statement.

    Attributes:
        segment: from 1 on.
        only_moment: whether that alone is stated, and neither force nor place.
        place_m: from the segment's joint centre.
        lateral_n: (2,) the force along y and z of the segment.
        moment_n_m: (2,) about the joint centre, around y and z of the segment.
        region_m: (2,) interval of the place, from the first joint centre along the straight arm.
        interval_n: (2,) of the lateral force.
    """

    segment: int
    only_moment: bool
    place_m: float
    lateral_n: Array
    moment_n_m: Array
    region_m: Array
    interval_n: Array

    @property
    def size_n(self) -> float:
        """The lateral force."""
        return float(np.hypot(*self.lateral_n))


@dataclass(frozen=True)
class Acting:
    """What acts on an arm at a command.

    Attributes:
        pushes: one or several; none of an untouched arm.
        axes: (N, 3, 3) of the segments at the command, as columns in base axes.
        length_m: (N,) of the segments.
    """

    pushes: tuple[Push, ...]
    axes: Array
    length_m: Array

    @property
    def joint_m(self) -> Array:
        """(N,) the joint centres along the straight arm."""
        return np.concatenate([[0.0], np.cumsum(self.length_m)[:-1]])

    def along_m(self, push: Push) -> float:
        """Where a push acts along the straight arm, from the first joint centre."""
        return float(self.joint_m[push.segment - 1]) + push.place_m

    def lateral_n(self, push: Push, segment: int) -> Array:
        """(2,) the force of a push along y and z of a segment."""
        return (self.axes[segment - 1].T @ push.force_n)[1:]

    def lateral_size_n(self, push: Push) -> float:
        """The force of a push across its own segment."""
        return float(np.hypot(*self.lateral_n(push, push.segment)))

    def moment_n_m(self, segment: int) -> Array:
        """(2,) of all pushes from a segment on, about its joint centre, around its y and z."""
        along_m = self.length_m[:, None] * self.axes[:, :, 0]
        joints_m = np.concatenate([np.zeros((1, 3)), along_m[:-1].cumsum(axis=0)])
        n = segment - 1
        moment_n_m = np.zeros(3)
        for push in self.pushes:
            if push.segment >= segment:
                point_m = joints_m[push.segment - 1] + self.axes[push.segment - 1] @ push.at_m
                moment_n_m += np.cross(point_m - joints_m[n], push.force_n)
        return (self.axes[n].T @ moment_n_m)[1:]

    def moment_as_force_n(self, segment: int) -> float:
        """The moment about a joint, over the length of its segment."""
        return float(np.hypot(*self.moment_n_m(segment)) / self.length_m[segment - 1])


@dataclass(frozen=True)
class Judged:
    """A vouched statement about a single contact, against the truth."""

    segment: int
    place_mm: float
    force_n: float
    half_n: float
    place_holds: bool
    force_holds: bool
    wrong: bool


def judged(acting: Acting, stated: Stated) -> Judged:
    """Errors of a statement about the only push."""
    (push,) = acting.pushes
    along_m = acting.along_m(push)
    stated_m = float(acting.joint_m[stated.segment - 1]) + stated.place_m
    lateral_n = acting.lateral_size_n(push)
    low_m, high_m = stated.region_m
    low_n, high_n = stated.interval_n
    same = stated.segment == push.segment
    near = _is_there(acting, push, stated)
    if stated.only_moment:
        near |= _is_on_segment(acting, stated.segment, along_m)
        wrong = not near or _moment_is_wrong(acting, stated)
    else:
        wrong = not near or not _is_force_of(acting, push, stated)
    off_n = _off_n(acting, push, stated) if same else abs(stated.size_n - lateral_n)
    return Judged(
        segment=push.segment,
        place_mm=1e3 * abs(stated_m - along_m),
        force_n=off_n,
        half_n=0.5 * (high_n - low_n),
        place_holds=bool(low_m - 1e-4 <= along_m <= high_m + 1e-4),
        force_holds=bool(low_n <= lateral_n <= high_n),
        wrong=bool(wrong),
    )


def misleads(acting: Acting, stated: Stated) -> bool:
    """Whether a statement about several contacts, or none, is wrong.

    A contact is wrong unless it is one of them; a moment, unless it is that of all of them.
    """
    if stated.only_moment:
        return _moment_is_wrong(acting, stated)
    if not acting.pushes:
        return stated.size_n > WRONG_N
    return not any(is_one(acting, push, stated) for push in acting.pushes)


def is_one(acting: Acting, push: Push, stated: Stated) -> bool:
    """Whether a stated contact is this one."""
    return _is_there(acting, push, stated) and _is_force_of(acting, push, stated)


def is_wrong(acting: Acting, stated: Stated) -> bool:
    """Whether a statement is wrong, of however many contacts."""
    if len(acting.pushes) == 1:
        return judged(acting, stated).wrong
    return misleads(acting, stated)


def error_n(acting: Acting, stated: Stated) -> float:
    """By how much a statement is off, N: of several contacts, from the nearest one.

    A contact that is stated where none is counts with the larger of both forces, a moment over the
    length of its segment.
    """
    if stated.only_moment:
        return _moment_off_n(acting, stated)
    errors_n = [
        _off_n(acting, push, stated)
        if _is_there(acting, push, stated)
        else max(stated.size_n, acting.lateral_size_n(push))
        for push in acting.pushes
    ]
    return min(errors_n, default=stated.size_n)


def _is_there(acting: Acting, push: Push, stated: Stated) -> bool:
    """Whether a contact is stated where this one is.

    Of several contacts only the place tells which of them is meant.
    """
    along_m = acting.along_m(push)
    stated_m = float(acting.joint_m[stated.segment - 1]) + stated.place_m
    near = abs(stated_m - along_m) < SAME_PLACE_M
    if len(acting.pushes) == 1:
        low_m, high_m = stated.region_m
        near |= stated.segment == push.segment or bool(low_m <= along_m <= high_m)
    return near


def _is_on_segment(acting: Acting, segment: int, along_m: float) -> bool:
    """Whether a place is on a segment: all that a moment says of it."""
    begins_m = float(acting.joint_m[segment - 1])
    ends_m = begins_m + float(acting.length_m[segment - 1])
    return begins_m - SAME_PLACE_M <= along_m <= ends_m + SAME_PLACE_M


def _is_force_of(acting: Acting, push: Push, stated: Stated) -> bool:
    true_n = float(np.hypot(*acting.lateral_n(push, stated.segment)))
    return _off_n(acting, push, stated) <= max(WRONG_N, WRONG_SHARE * true_n)


def _off_n(acting: Acting, push: Push, stated: Stated) -> float:
    return float(np.hypot(*(stated.lateral_n - acting.lateral_n(push, stated.segment))))


def _moment_is_wrong(acting: Acting, stated: Stated) -> bool:
    true_n = acting.moment_as_force_n(stated.segment)
    return _moment_off_n(acting, stated) > max(WRONG_N, WRONG_SHARE * true_n)


def _moment_off_n(acting: Acting, stated: Stated) -> float:
    length_m = float(acting.length_m[stated.segment - 1])
    off_n_m = float(np.hypot(*(stated.moment_n_m - acting.moment_n_m(stated.segment))))
    return off_n_m / length_m


def share(values: Sequence[bool]) -> float | None:
    """The share of true values; None of none."""
    return round(float(np.mean(values)), 4) if len(values) else None
