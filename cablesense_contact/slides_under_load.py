"""How slides change while a load acts on the arm, as its readings tell.

The actuators stand still: a reading that rises shows that cable slides over the pulley towards the
arm. How the joints give way follows from how much longer all cables have got, by least squares,
with a covariance. What has then passed a guide, one after the other, is what the pieces before it
stretch and their spans do not take up; how surely, and so in which direction its cable slid,
follows from that covariance and from what is known of the tensions behind the pulleys.

What a cable has slid there and back on the way shows in no reading. The shares and deviations that
stand for it have no derivation: they were chosen on arms of the plant with friction of 0.02 to
0.15, of other seeds than those of any published figure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_contact.cable_routes import CableRoutes
from cablesense_contact.slides import SLIDING_STD, Passed, Slides, play_compliance_m_n, played

_RETURNED_STD = 0.6
"""Of all slides together once a load was taken off, in the direction of the load: friction holds
a part of it."""
_TURNED_BACK_SHARE = 0.02
"""How far the tension behind a pulley may have gone back since cable slid there, as a share of the
largest change of a reading."""
_FIRM_SHARE = 0.1
"""Where a reading has changed by more than this share of the largest change, it has not."""
_PASSED_SHARE = 0.12
"""How far off what has passed a guide may be, as a share of the most that has passed any: while
much passes others, a cable may slide there and back."""
_SMOOTHED = 16
"""Readings of which the mean is followed while they do not change, that is by no more than"""
_STEADY_SHARE = 0.6
"""this share of a change that shows that a cable has moved: three deviations."""
_STANDS_SHARE = 0.2
"""As long as the mean has changed by less than this share of it, one deviation, slides stay."""
_LEAST_FRICTION = 1e-4
"""In place of a coefficient whose mean is zero or less: something is divided by it."""
_LEAST_INFORMATION_SHARE = 1e-9
_LEAST_INFORMATION_M2 = 1e-12
"""Added to the information of how joints give way, as a share of all of it and at the least, so
that it has an inverse."""
_LEAST_PLAY_M = 1e-12
"""Play of a guide over which a cable goes straight: something is divided by it."""
_LEAST_HELD_N = 1e-9
"""Tension that friction at the first guide holds, at the least: something is divided by it."""


class SlidesAtPose:
    """What changes of readings say of slides, with the machine at one command."""

    def __init__(self, routes: CableRoutes, command: Array) -> None:
        """For a command (C,)."""
        self._slope_m = routes.slope_m(command)
        self._by_coordinate = self._slope_m.sum(axis=1)
        self._run_m_n = routes.compliance_m_n[:, 0]
        self._pieces_m_n = routes.compliance_m_n[:, 1:]
        self._behind_m_n = self._pieces_m_n.sum(axis=1)
        wrap_rad = routes.wrap_rad(command)
        later_wrap_rad = wrap_rad[:, 1:]
        self._first_wrap_rad = wrap_rad[:, 0]
        self._wrap_so_far_rad = later_wrap_rad.cumsum(axis=1)
        self._returning = routes.returning
        self._play_m_n = 2.0 * later_wrap_rad * play_compliance_m_n(routes.compliance_m_n)[:, 1:]
        # up to each piece behind the first guide, of independent slides at those between
        up_to_piece_rad = np.sqrt((later_wrap_rad**2).cumsum(axis=1))
        self._later_wrap_rad = np.concatenate(
            [np.zeros((len(up_to_piece_rad), 1)), up_to_piece_rad], axis=1
        )

    def changed(
        self,
        before: Slides,
        before_n: Array,
        now_n: Array,
        moved: NDArray[np.bool_],
        moved_n: float,
        friction: float,
        common: Array,
    ) -> Slides:
        """The slides after readings have changed.

        Args:
            before: the slides at the readings
            before_n: (M,) since which no cable has turned back.
            now_n: (M,) the present readings.
            moved: (M,) which cables have moved since.
            moved_n: change that shows that.
            friction: its coefficient, as known.
            common: (G, M) of the slides.
        """
        change_n = now_n - before_n
        if not moved.any():
            return before
        # tensions behind the first guide, by which the pieces there stretch: known where it slides
        slid = np.where(moved, np.sign(change_n), before.mean[0])
        carried = friction * self._first_wrap_rad
        behind_n = now_n * np.exp(carried * slid) - before_n * np.exp(carried * before.mean[0])
        held_n_rad = max(friction, _LEAST_FRICTION) * np.maximum(now_n, moved_n)
        held_n = np.maximum(held_n_rad * self._first_wrap_rad, _LEAST_HELD_N)
        std_n = np.where(moved, moved_n + SLIDING_STD * held_n, moved_n + held_n)
        longer_m = self._run_m_n * change_n + self._behind_m_n * behind_n
        # what the other guides carry is not known here: of each piece behind them
        later_std_n = held_n_rad[:, None] * self._later_wrap_rad
        later_std_m = self._pieces_m_n * later_std_n
        longer_std_m = np.hypot(self._behind_m_n * std_n, later_std_m.sum(axis=1))
        weight = (np.minimum(before_n, now_n) > moved_n) / longer_std_m
        # the joints have given way by as much as the cables got longer
        weighted = weight[:, None] * self._by_coordinate
        gave_way = np.linalg.lstsq(weighted, weight * longer_m, rcond=None)[0]
        information = weighted.T @ weighted
        # where no taut cable tells how a joint gave way, it may be anything
        least = _LEAST_INFORMATION_SHARE * np.trace(information) + _LEAST_INFORMATION_M2
        gave_way_covariance = np.linalg.inv(information + least * np.eye(len(information)))
        taken_m = self._slope_m[:, 1:] @ gave_way
        # a cable that stands at its first guide: what its pieces take up, it stretches behind
        stands_n = (taken_m.sum(axis=1) - self._run_m_n * change_n) / self._behind_m_n
        stands = np.clip(before.mean[0] + stands_n / held_n, -1.0, 1.0)
        behind_n = np.where(moved, behind_n, held_n * (stands - before.mean[0]))
        # what the pieces before a guide stretch, and do not take up, has passed it
        between_m = self._pieces_m_n * behind_n[:, None] - taken_m
        passed_m = (self._run_m_n * change_n)[:, None] + between_m[:, :-1].cumsum(axis=1)
        earlier = Slides(before.mean[1:], before.std[1:], before.common[1:])
        all_taken_m = self._slope_m[:, 1:].sum(axis=1)
        taken_std_m = np.sqrt(((all_taken_m @ gave_way_covariance) * all_taken_m).sum(axis=1))
        stands_std_n = np.minimum(taken_std_m / self._behind_m_n, held_n)
        behind_std_n = np.where(moved, std_n, stands_std_n)
        passed_std_m = self._passed_std_m(passed_m, behind_std_n, later_std_m, gave_way_covariance)
        held_m = (
            max(friction, _LEAST_FRICTION) * self._play_m_n * np.maximum(now_n, moved_n)[:, None]
        )
        play_m = np.maximum(held_m, _LEAST_PLAY_M)
        guides = played(earlier, Passed(passed_m.T, passed_std_m.T), play_m.T)
        guides = self._doubted(guides, friction)
        slid_std = self._slid_std(change_n, held_n)
        stands_std = np.hypot(SLIDING_STD, stands_std_n / held_n)
        pulley_std = np.where(moved, slid_std, stands_std)
        return Slides(
            np.vstack([np.where(moved, slid, stands), guides.mean]),
            np.vstack([pulley_std, guides.std]),
            common,
        )

    def _passed_std_m(
        self, passed_m: Array, behind_std_n: Array, later_std_m: Array, gave_way_covariance: Array
    ) -> Array:
        """(M, G - 1) deviations of what has passed the guides behind the first.

        By those of the tensions behind the first (M,) and of what pieces stretch by the others
        (M, G), by the covariance (n, n) of how the joints gave way, and by what passed on the way
        and came back.
        """
        by_behind_m_n = self._pieces_m_n[:, :-1].cumsum(axis=1)
        by_way = self._slope_m[:, 1:-1].cumsum(axis=1)
        of_way_m2 = ((by_way @ gave_way_covariance) * by_way).sum(axis=2)
        of_behind_m = by_behind_m_n * behind_std_n[:, None]
        of_later_m = later_std_m[:, :-1].cumsum(axis=1)
        of_path_m = _PASSED_SHARE * np.abs(passed_m).max()
        return np.sqrt(of_way_m2 + of_behind_m**2 + of_later_m**2 + of_path_m**2)

    def _doubted(self, slides: Slides, friction: float) -> Slides:
        """Slides (G - 1, M) of guides that see the more another tension the further back they are.

        Tensions behind a guide are taken to change as before it. Where the cable slides they
        change by exp(-μ Φ) of that: by this probability the slide is as computed, else anything
        from -1 to 1. So it may be where cables slide there and back on their way.
        """
        sure = (1.0 - self._returning) * np.exp(-friction * self._wrap_so_far_rad.T)
        mean = sure * slides.mean
        square = sure * (slides.mean**2 + slides.std**2) + (1.0 - sure) / 3.0
        return Slides(mean, np.sqrt(square - mean**2), slides.common)

    def _slid_std(self, change_n: Array, held_n: Array) -> Array:
        """(M,) deviations of the slides of cables that have slid while readings changed.

        Where a reading has changed little while others changed much, the tension may have gone up
        and down: on its way back the cable sticks, and the sensor does not see it.
        """
        largest_n = np.abs(change_n).max()
        small = np.abs(change_n) < _FIRM_SHARE * largest_n
        turned_back = small * _TURNED_BACK_SHARE * largest_n / held_n
        return np.minimum(np.hypot(SLIDING_STD, turned_back), 1.0)


@dataclass(frozen=True)
class SlidesUnderLoad:
    """What readings at one command have said of slides so far, from the untouched arm on.

    As long as no cable turns back, what has slid where follows from the change since the
    beginning; then from the change since the turn.

    Attributes:
        pose: the command.
        moved_n: change that shows that a cable has moved.
        friction: its coefficient, as known.
        slides: at the last reading.
        turn_n: (M,) readings at the last turn, or of the untouched arm, and
        at_turn: the slides then.
        common: (G, M) what all slides are off by together since.
        moved: (M,) which cables have moved since.
        followed_n: (M,) the readings of which `slides` are.
        steady_n, steady_count: (M,) mean of the last readings that do not change, and how many.
        way: (M,) 1 where a reading has risen, -1 where it has fallen, since it last turned.
        outermost_n: (M,) each reading the farthest on its way, and
        at_outermost_n: (M, M) all readings then, by rows.
    """

    pose: SlidesAtPose
    moved_n: float
    friction: float
    slides: Slides
    turn_n: Array
    at_turn: Slides
    common: Array
    moved: NDArray[np.bool_]
    followed_n: Array
    steady_n: Array
    steady_count: int
    way: Array
    outermost_n: Array
    at_outermost_n: Array

    @classmethod
    def begin(
        cls,
        pose: SlidesAtPose,
        arrived: Slides,
        untouched_n: Array,
        moved_n: float,
        friction: float,
    ) -> SlidesUnderLoad:
        """Begin with the untouched arm, its readings (M,) and the slides with which it came."""
        cables = len(untouched_n)
        return cls(
            pose=pose,
            moved_n=moved_n,
            friction=friction,
            slides=arrived,
            turn_n=untouched_n,
            at_turn=arrived,
            common=np.zeros_like(arrived.mean),
            moved=np.zeros(cables, dtype=bool),
            followed_n=untouched_n,
            steady_n=untouched_n,
            steady_count=1,
            way=np.zeros(cables),
            outermost_n=untouched_n,
            at_outermost_n=np.tile(untouched_n, (cables, 1)),
        )

    def after(self, reading_n: Array) -> SlidesUnderLoad:
        """What is known after the next readings (M,)."""
        smoothed = self._smoothed(reading_n)
        now_n = smoothed.steady_n
        if np.abs(now_n - self.followed_n).max() < _STANDS_SHARE * self.moved_n:
            return smoothed
        off_n = now_n - self.outermost_n
        turns = (np.abs(off_n) > self.moved_n) & (np.sign(off_n) != self.way)
        turns_back = turns & (self.way != 0.0)
        turn_n = self.turn_n
        at_turn = self.at_turn
        moved = self.moved
        common = self.common
        if turns_back.any():
            first = int(np.argmax(np.abs(off_n) * turns_back))
            turn_n = self.at_outermost_n[first]
            at_turn = self.slides
            moved = np.zeros_like(self.moved)
            common = np.tile(_RETURNED_STD * self.way, (len(self.slides.mean), 1))
        moved = moved | (np.abs(now_n - turn_n) > self.moved_n)
        slides = self.pose.changed(
            at_turn, turn_n, now_n, moved, self.moved_n, self.friction, common
        )
        further = turns | (off_n * self.way > 0.0)
        return replace(
            smoothed,
            slides=slides,
            turn_n=turn_n,
            at_turn=at_turn,
            common=common,
            moved=moved,
            followed_n=now_n,
            way=np.where(turns, np.sign(off_n), self.way),
            outermost_n=np.where(further, now_n, self.outermost_n),
            at_outermost_n=np.where(further[:, None], now_n, self.at_outermost_n),
        )

    def _smoothed(self, reading_n: Array) -> SlidesUnderLoad:
        """With the mean of the last readings while these do not change, else with the last."""
        if np.abs(reading_n - self.steady_n).max() > _STEADY_SHARE * self.moved_n:
            return replace(self, steady_n=reading_n, steady_count=1)
        count = min(self.steady_count + 1, _SMOOTHED)
        steady_n = self.steady_n + (reading_n - self.steady_n) / count
        return replace(self, steady_n=steady_n, steady_count=count)
