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

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_contact.cable_routes import CableRoutes
from cablesense_contact.slides import (
    SLIDING_STD,
    KnownLengths,
    Slides,
    play_compliance_m_n,
    played,
)

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
"""In place of a coefficient whose mean is zero, or below it by readings of an arm that does not
rub: something is divided by it."""
_LEAST_INFORMATION_SHARE = 1e-9
_LEAST_INFORMATION_M2 = 1e-12
"""Added to the information of how joints give way, as a share of all of it and at the least, so
that it has an inverse."""
_LEAST_PLAY_M = 1e-12
"""Play of a guide over which a cable goes straight: something is divided by it."""
_LEAST_HELD_N = 1e-9
"""Tension that friction at the first guide holds, at the least: something is divided by it."""


class _Yielding(NamedTuple):
    """How the joints have given way to a load: mean (n,) and covariance (n, n)."""

    mean: Array
    covariance: Array


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
        self._play_m_rad = 2.0 * later_wrap_rad * play_compliance_m_n(routes.compliance_m_n)[:, 1:]
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
    ) -> Slides:
        """The slides after readings have changed.

        Args:
            before: the slides at the readings
            before_n: (M,) since which no cable has turned back.
            now_n: (M,) the present readings.
            moved: (M,) which cables have moved since.
            moved_n: change that shows that.
            friction: its coefficient, as known.
        """
        if not moved.any():
            return before
        coefficient = max(friction, _LEAST_FRICTION)
        change_n = now_n - before_n
        holding_n_rad = coefficient * np.maximum(now_n, moved_n)
        holding_n = np.maximum(holding_n_rad * self._first_wrap_rad, _LEAST_HELD_N)
        # tensions behind the first guide, by which the pieces there stretch: known where it slides
        slid = np.where(moved, np.sign(change_n), before.mean[0])
        carried = coefficient * self._first_wrap_rad
        behind_n = now_n * np.exp(carried * slid) - before_n * np.exp(carried * before.mean[0])
        behind_std_n = moved_n + np.where(moved, SLIDING_STD, 1.0) * holding_n
        # what the other guides carry is not known here: of each piece behind them
        later_std_m = self._pieces_m_n * holding_n_rad[:, None] * self._later_wrap_rad
        longer = KnownLengths(
            self._run_m_n * change_n + self._behind_m_n * behind_n,
            np.hypot(self._behind_m_n * behind_std_n, later_std_m.sum(axis=1)),
        )
        is_taut = np.minimum(before_n, now_n) > moved_n
        yielding = self._yielding(longer, is_taut)
        taken_m = self._slope_m[:, 1:] @ yielding.mean
        # a cable that stands at its first guide: what its pieces take up, it stretches behind
        run_m = self._run_m_n * change_n
        stretched_n = (taken_m.sum(axis=1) - run_m) / self._behind_m_n
        stands = np.clip(before.mean[0] + stretched_n / holding_n, -1.0, 1.0)
        stands_std_n = np.minimum(self._taken_std_m(yielding) / self._behind_m_n, holding_n)
        behind_n = np.where(moved, behind_n, holding_n * (stands - before.mean[0]))
        behind_std_n = np.where(moved, behind_std_n, stands_std_n)
        # what the pieces before a guide stretch, and do not take up, would pass it
        between_m = self._pieces_m_n * behind_n[:, None] - taken_m
        passed_m = run_m[:, None] + between_m[:, :-1].cumsum(axis=1)
        passed_std_m = self._passed_std_m(passed_m, behind_std_n, later_std_m, yielding)
        play_m = np.maximum(self._play_m_rad * holding_n_rad[:, None], _LEAST_PLAY_M)
        earlier = Slides(before.mean[1:], before.std[1:])
        guides = played(earlier, KnownLengths(passed_m.T, passed_std_m.T), play_m.T)
        guides = self._doubted(guides, coefficient)
        stands_std = np.hypot(SLIDING_STD, stands_std_n / holding_n)
        first_mean = np.where(moved, slid, stands)
        first_std = np.where(moved, self._slid_std(change_n, holding_n), stands_std)
        return Slides(np.vstack([first_mean, guides.mean]), np.vstack([first_std, guides.std]))

    def _yielding(self, longer: KnownLengths, is_taut: NDArray[np.bool_]) -> _Yielding:
        """How the joints gave way, (n,) and (n, n), by how much longer cables (M,) have got."""
        weight = is_taut / longer.std_m
        weighted = weight[:, None] * self._by_coordinate
        mean = np.linalg.lstsq(weighted, weight * longer.mean_m, rcond=None)[0]
        information = weighted.T @ weighted
        # where no taut cable tells how a joint gave way, it may be anything
        least = _LEAST_INFORMATION_SHARE * np.trace(information) + _LEAST_INFORMATION_M2
        return _Yielding(mean, np.linalg.inv(information + least * np.eye(len(information))))

    def _taken_std_m(self, yielding: _Yielding) -> Array:
        """(M,) deviations of what the pieces behind the first guide take up together."""
        by_way = self._slope_m[:, 1:].sum(axis=1)
        return np.sqrt(((by_way @ yielding.covariance) * by_way).sum(axis=1))

    def _passed_std_m(
        self, passed_m: Array, behind_std_n: Array, later_std_m: Array, yielding: _Yielding
    ) -> Array:
        """(M, G - 1) deviations of what has passed the guides behind the first.

        By those of the tensions behind the first (M,) and of what pieces stretch by the others
        (M, G), by how the joints gave way, and by what passed on the way
        and came back.
        """
        by_behind_m_n = self._pieces_m_n[:, :-1].cumsum(axis=1)
        by_way = self._slope_m[:, 1:-1].cumsum(axis=1)
        of_way_m2 = ((by_way @ yielding.covariance) * by_way).sum(axis=2)
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
        return Slides(mean, np.sqrt(square - mean**2))

    def _slid_std(self, change_n: Array, holding_n: Array) -> Array:
        """(M,) deviations of the slides of cables that have slid while readings changed.

        Where a reading has changed little while others changed much, the tension may have gone up
        and down: on its way back the cable sticks, and the sensor does not see it.
        """
        largest_n = np.abs(change_n).max()
        small = np.abs(change_n) < _FIRM_SHARE * largest_n
        turned_back = small * _TURNED_BACK_SHARE * largest_n / holding_n
        return np.minimum(np.hypot(SLIDING_STD, turned_back), 1.0)


class SlidesUnderLoad(NamedTuple):
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
        if turns_back.any():
            first = int(np.argmax(np.abs(off_n) * turns_back))
            turn_n = self.at_outermost_n[first]
            at_turn = self.slides
            moved = np.zeros_like(self.moved)
        moved = moved | (np.abs(now_n - turn_n) > self.moved_n)
        slides = self.pose.changed(at_turn, turn_n, now_n, moved, self.moved_n, self.friction)
        further = turns | (off_n * self.way > 0.0)
        return smoothed._replace(
            slides=slides,
            turn_n=turn_n,
            at_turn=at_turn,
            moved=moved,
            followed_n=now_n,
            way=np.where(turns, np.sign(off_n), self.way),
            outermost_n=np.where(further, now_n, self.outermost_n),
            at_outermost_n=np.where(further[:, None], now_n, self.at_outermost_n),
        )

    def _smoothed(self, reading_n: Array) -> SlidesUnderLoad:
        """With the mean of the last readings while these do not change, else with the last."""
        if np.abs(reading_n - self.steady_n).max() > _STEADY_SHARE * self.moved_n:
            return self._replace(steady_n=reading_n, steady_count=1)
        count = min(self.steady_count + 1, _SMOOTHED)
        steady_n = self.steady_n + (reading_n - self.steady_n) / count
        return self._replace(steady_n=steady_n, steady_count=count)
