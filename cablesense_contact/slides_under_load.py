"""How slides change while a load acts on the arm, as its readings tell.

The actuators stand still: a reading that rises shows that cable slides over the pulley towards the
arm. How the joints give way follows from how much longer all cables have got, by least squares.
What has then passed a guide, one after the other, is what the pieces before it stretch and their
spans do not take up.

The deviations here have no derivation. They were chosen on arms of the plant with friction of 0.02
to 0.15, of other seeds than those of any published figure.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_contact.slides import SLIDING_STD, Slides, turned
from cablesense_sim import kinematics
from cablesense_sim.mechanism import Mechanism

_RETURNED_STD = 0.6
"""Of all slides together once a load was taken off, in the direction of the load: friction holds
a part of it."""
_STANDING_STD = 0.7
"""Deviation of the slide where cable stands at its pulley, as computed from how the joints gave
way."""
_GUIDE_STD = 0.7
"""Deviation of slides at the guides in the arm under a load: they follow from how the joints give
way, which readings show as well as they show what friction holds."""
_SMOOTHED = 16
"""Readings of which the mean is followed while they do not change, that is by no more than"""
_STEADY_SHARE = 0.6
"""this share of a change that shows that a cable has moved: three deviations."""
_STANDS_SHARE = 0.2
"""As long as the mean has changed by less than this share of it, one deviation, slides stay."""
_LEAST_FRICTION = 1e-4
"""In place of a coefficient whose mean is zero or less: something is divided by it."""
_GUIDE_SHARE = 0.5
"""Way over which a cable turns at a guide by that at a pulley. It is less by the wrap, but what
passes is known about so well only, as what pulleys carry is not known better."""


class SlidesAtPose:
    """What changes of readings say of slides, with the arm at one command."""

    def __init__(
        self, mechanism: Mechanism, command_rad: Array, turning_m: Array, before_pulley: Array
    ) -> None:
        """For a command (2N,).

        `turning_m` (M,) is the way over which a cable turns to slide back over its pulley, and
        `before_pulley` (M,) the share of its compliance that lies before it.
        """
        count = mechanism.segment_count
        cables = mechanism.cable_count
        self._by_angle = kinematics.cable_jacobian_m(mechanism, command_rad)
        self._by_joint = self._by_angle.reshape(cables, count, 2)
        pieces = mechanism.piece_length_m
        behind_m_n = (1.0 - before_pulley) / mechanism.stiffness_n_m
        self._pieces_m_n = behind_m_n[:, None] * pieces / pieces.sum(axis=1, keepdims=True)
        self._behind_m_n = behind_m_n
        self._run_m_n = before_pulley / mechanism.stiffness_n_m
        self._guides_turn_m = _GUIDE_SHARE * turning_m

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
            common: (N + 1, M) of the slides.
        """
        change_n = now_n - before_n
        if not moved.any():
            return before
        # tensions behind the pulley, by which the pieces there stretch: known where cable slides
        slid = np.where(moved, np.sign(change_n), before.mean[0])
        behind_n = now_n * np.exp(friction * slid) - before_n * np.exp(friction * before.mean[0])
        held_n = max(friction, _LEAST_FRICTION) * np.maximum(now_n, moved_n)
        std_n = np.where(moved, moved_n + SLIDING_STD * held_n, moved_n + held_n)
        longer_m = self._run_m_n * change_n + self._behind_m_n * behind_n
        weight = (np.minimum(before_n, now_n) > moved_n) / (self._behind_m_n * std_n)
        # the joints have given way by as much as the cables got longer
        turned_rad = np.linalg.lstsq(
            weight[:, None] * self._by_angle, weight * longer_m, rcond=None
        )[0]
        taken_m = (self._by_joint * turned_rad.reshape(-1, 2)).sum(axis=-1)
        # a cable that stands at its pulley: what its spans take up, it stretches behind
        stands_n = (taken_m.sum(axis=1) - self._run_m_n * change_n) / self._behind_m_n
        stands = np.clip(before.mean[0] + stands_n / held_n, -1.0, 1.0)
        behind_n = np.where(moved, behind_n, held_n * (stands - before.mean[0]))
        # what the pieces before a guide stretch, and their spans do not take up, has passed it
        pieces_m = self._pieces_m_n * behind_n[:, None]
        between_m = pieces_m[:, 0::2].copy()
        between_m[:, 1:] += pieces_m[:, 1:-1:2] - taken_m[:, :-1]
        passed_m = (self._run_m_n * change_n)[:, None] + between_m.cumsum(axis=1)
        earlier = Slides(before.mean[1:], before.std[1:], before.common[1:])
        guides = turned(earlier, passed_m.T, self._guides_turn_m, _GUIDE_STD)
        pulley_std = np.where(moved, SLIDING_STD, _STANDING_STD)
        return Slides(
            np.vstack([np.where(moved, slid, stands), guides.mean]),
            np.vstack([pulley_std, guides.std]),
            common,
        )


class SlidesUnderLoad:
    """Follows readings at one command, from the untouched arm on.

    As long as no cable turns back, what has slid where follows from the change since the
    beginning; then from the change since the turn.

    Attributes:
        slides: at the last reading.
    """

    def __init__(
        self,
        pose: SlidesAtPose,
        arrived: Slides,
        untouched_n: Array,
        moved_n: float,
        friction: float,
    ) -> None:
        """Begin with the untouched arm.

        Args:
            pose: the command.
            arrived: the slides with which the arm came there.
            untouched_n: (M,) its readings.
            moved_n: change that shows that a cable has moved.
            friction: its coefficient, as known.
        """
        self._pose = pose
        self._moved_n = moved_n
        self._friction = friction
        self._turn_n = untouched_n
        self._at_turn = arrived
        self._common = np.zeros_like(arrived.mean)
        self._moved = np.zeros(len(untouched_n), dtype=bool)
        self._followed_n = untouched_n
        self._steady_n = untouched_n
        self._steady = 1
        self._way = np.zeros(len(untouched_n))
        self._outermost_n = untouched_n
        self._at_outermost_n = np.tile(untouched_n, (len(untouched_n), 1))
        self.slides = arrived

    def follow(self, reading_n: Array) -> Slides:
        """Take the next readings (M,); gives the slides then."""
        now_n = self._smoothed(reading_n)
        if np.abs(now_n - self._followed_n).max() < _STANDS_SHARE * self._moved_n:
            return self.slides
        self._followed_n = now_n
        off_n = now_n - self._outermost_n
        turns = (np.abs(off_n) > self._moved_n) & (np.sign(off_n) != self._way)
        turns_back = turns & (self._way != 0.0)
        if turns_back.any():
            first = int(np.argmax(np.abs(off_n) * turns_back))
            self._turn_n = self._at_outermost_n[first].copy()
            self._at_turn = self.slides
            self._moved[:] = False
            self._common = np.tile(_RETURNED_STD * self._way, (len(self.slides.mean), 1))
        further = turns | (off_n * self._way > 0.0)
        self._way = np.where(turns, np.sign(off_n), self._way)
        self._outermost_n = np.where(further, now_n, self._outermost_n)
        self._at_outermost_n[further] = now_n
        self._moved |= np.abs(now_n - self._turn_n) > self._moved_n
        self.slides = self._pose.changed(
            self._at_turn,
            self._turn_n,
            now_n,
            self._moved,
            self._moved_n,
            self._friction,
            self._common,
        )
        return self.slides

    def _smoothed(self, reading_n: Array) -> Array:
        """(M,) the mean of the last readings while these do not change."""
        if np.abs(reading_n - self._steady_n).max() > _STEADY_SHARE * self._moved_n:
            self._steady_n = reading_n
            self._steady = 1
            return reading_n
        self._steady = min(self._steady + 1, _SMOOTHED)
        self._steady_n = self._steady_n + (reading_n - self._steady_n) / self._steady
        return self._steady_n
