"""Where cables slide at their guides, and what friction therefore adds to their tensions.

At a guide with the wrap Φ the tension behind it is exp(u μ Φ) times that before it (`before` is
towards the actuator), with the slide u between -1 and 1. It is 1 where cable last slid towards the
arm, -1 where it slid back, and anything between where it sticks. So u μ, the carried friction ε,
has with a coefficient μ that is known to its mean and variance only

    E ε = E[u] E[μ],    cov(ε, x) = E[u] cov(μ, x),
    cov(ε_a, ε_b) = E[u_a] E[u_b] var μ,    var ε = E[u]² var μ + var u E[μ²],

where x is any other parameter, and slides are independent of one another and of μ.

What is known of slides comes from the arm's motion, which passes cable over the guides, and from
changes of the readings. Under a load the actuators stand still: a reading that rises shows that
cable slides over the pulley towards the arm, and guide by guide what has passed follows from the
stretch of the pieces before it and from how the joints have given way.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim import kinematics
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.tolerances import ArmParameters

MOVED_STD = 5.0
"""A cable has moved if its reading has changed by this many deviations of a reading."""
_SLIDING_STD = 0.1
"""Deviation of the slide where cable has slid: the last of the way may have been back."""
_TURNING_RAD = float(np.deg2rad(1.0))
"""Over so much of its last way the direction of a motion counts."""
_RETURNED_STD = 0.6
"""Of all slides together once a load was taken off, in the direction of the load: friction holds
a part of it."""
_STANDING_STD = 0.7
"""Deviation of the slide where cable stands at its pulley, as computed from how the joints gave
way."""
_STEPS_OF_MOTION = 16
"""In which a motion is followed: on a straight way of the joints a cable may turn back."""
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
_TRIFLE = 0.1
"""Friction counts if it makes more than this share of the change that shows that a cable has
moved."""
_ROUNDED = 1.0 / 16.0
_BEFORE_PULLEY = 0.3
"""Share of a cable's compliance that is taken to lie before its pulley, where cable passes."""
_GUIDE_SHARE = 0.5
"""Way over which a cable turns at a guide by that at a pulley. It is less by the wrap, but what
passes is known about so well only, as what pulleys carry is not known better."""
_FREED_STD = 0.05
"""Deviation of slides after a breath."""


class Belief(NamedTuple):
    """What is known of the arm at one sample: mean (P,) and covariance (P, P)."""

    mean: Array
    covariance: Array


class Slides(NamedTuple):
    """What is known of the slides of M cables at their guides 0 (the pulley) to N.

    Attributes:
        mean: (N + 1, M), from -1 to 1.
        std: (N + 1, M), independent of one another, and
        common: (N + 1, M) what all are off by together, times a standard normal number.
    """

    mean: Array
    std: Array
    common: Array


class LastWay:
    """The way (K, 2N) of the commands of an unloaded arm, as far back as it matters to slides."""

    def __init__(self) -> None:
        """Nothing is known yet."""
        self._way_rad: list[Array] = []

    def go(self, command_rad: Array) -> None:
        """Add the next command (2N,)."""
        self._way_rad.append(command_rad)
        while len(self._way_rad) > 2:
            back_rad = np.abs(self._way_rad[1] - command_rad).max()
            if back_rad < _TURNING_RAD:
                break
            del self._way_rad[0]

    def forget(self) -> None:
        """Something else has moved the cables since."""
        del self._way_rad[:-1]

    @property
    def came_from_rad(self) -> Array | None:
        """(2N,) where the motion to the present command came from; None if that is not known."""
        return self._way_rad[0] if len(self._way_rad) > 1 else None


class CableSlides:
    """The slides of an arm's cables, by what has moved them.

    Attributes:
        unknown: the arm has moved, who knows in which direction.
        freed: after a breath, which takes friction out of all readings.
    """

    def __init__(self, mechanism: Mechanism, parameters: ArmParameters) -> None:
        """For the arm of a file, with its uncertain parameters."""
        self._mechanism = mechanism
        self._carried = parameters.carried_friction
        self._coefficient = parameters.slices["friction"].start
        self._exists = (parameters.prior_std[self._carried] > 0.0).astype(float)
        shape = (mechanism.segment_count + 1, mechanism.cable_count)
        nothing = np.zeros(shape)
        self.unknown = Slides(nothing, np.ones(shape), nothing)
        self.freed = Slides(nothing, np.full(shape, _FREED_STD), nothing)
        self._pretension_n = float(np.max(mechanism.pretension_n))
        # to slide back, a cable that carries ε = μ has to be stretched until it carries -μ
        start = parameters.prior_mean[self._coefficient], parameters.prior_std[self._coefficient]
        behind_m_n = (1.0 - _BEFORE_PULLEY) / mechanism.stiffness_n_m
        turning_m = 2.0 * math.hypot(*start) * mechanism.pretension_n * behind_m_n
        self._turning_m = np.maximum(turning_m, 1e-12)

    def after_motion(self, from_rad: Array, to_rad: Array) -> Slides:
        """Those of the unloaded arm after a straight motion between two commands (2N,).

        What passes a guide is what the spans behind it take up. After a turn it slides again when
        it has stretched by the friction that it carried.
        """
        shares = np.linspace(0.0, 1.0, _STEPS_OF_MOTION + 1)[:, None]
        span_m = kinematics.spans(
            self._mechanism, from_rad + shares * (to_rad - from_rad)
        ).length_m
        behind_m = span_m[..., ::-1].cumsum(axis=-1)[..., ::-1].swapaxes(-1, -2)
        behind_m = np.concatenate([behind_m[:, :1], behind_m], axis=1)  # pulley and first guide
        slides = self.unknown
        for passed_m in np.diff(behind_m, axis=0):
            slides = _turned(slides, passed_m, self._turning_m)
        return slides

    def matter(self, known: Belief, moved_n: float) -> bool:
        """Whether friction makes more of a reading than a trifle of a change that shows."""
        friction_n = self._pretension_n * math.sqrt(self._mean_square(known))
        return friction_n > _TRIFLE * moved_n

    def at_pose(self, command_rad: Array) -> SlidesAtPose:
        """What changes of readings at one command (2N,) say of slides."""
        return SlidesAtPose(self._mechanism, command_rad, self._turning_m)

    def rounded(self, slides: Slides) -> tuple[bytes, Slides]:
        """Slides to a sixteenth, and a key of them: nearly the same ones are one."""
        mean = np.rint(slides.mean / _ROUNDED)
        std = np.maximum(np.rint(slides.std / _ROUNDED), 1.0)
        common = np.rint(slides.common / _ROUNDED)
        key = b"".join(part.astype(np.int8).tobytes() for part in (mean, std, common))
        return key, Slides(_ROUNDED * mean, _ROUNDED * std, _ROUNDED * common)

    def alike(self, slides: Sequence[Slides]) -> Iterator[tuple[Slides, NDArray[np.int64]]]:
        """Slides that differ, each with the positions where it stands."""
        rows: dict[bytes, list[int]] = {}
        by_key: dict[bytes, Slides] = {}
        for row, one in enumerate(slides):
            key, rounded = self.rounded(one)
            rows.setdefault(key, []).append(row)
            by_key[key] = rounded
        for key, rounded in by_key.items():
            yield rounded, np.array(rows[key], dtype=np.int64)

    def carried(self, known: Belief, slides: Slides) -> Belief:
        """What is known with these slides: the mean and covariance of what friction carries."""
        part = self._carried
        slide = slides.mean.ravel() * self._exists
        mean = known.mean.copy()
        covariance = known.covariance.copy()
        of_coefficient = known.covariance[self._coefficient].copy()
        of_coefficient[part] = 0.0
        mean[part] = slide * known.mean[self._coefficient]
        with_others = np.outer(slide, of_coefficient)
        covariance[part] = with_others
        covariance[:, part] = with_others.T
        common = slides.common.ravel() * self._exists
        together = of_coefficient[self._coefficient] * np.outer(slide, slide)
        together += self._mean_square(known) * np.outer(common, common)
        covariance[part, part] = together + np.diag(self.alone(known, slides))
        return Belief(mean, covariance)

    def by_lasting(self, slope: Array, slides: Slides) -> Array:
        """Slopes (M, P) of readings by parameters, without what friction carries.

        They have the coefficient's share in it instead.
        """
        slide = slides.mean.ravel() * self._exists
        lasting = slope.copy()
        lasting[:, self._coefficient] += slope[:, self._carried] @ slide
        lasting[:, self._carried] = 0.0
        return lasting

    def alone(self, known: Belief, slides: Slides) -> Array:
        """((N + 1) M,) variances of what is carried by the slides alone, in their order."""
        variance = (slides.std.ravel() * self._exists) ** 2
        return np.asarray(self._mean_square(known) * variance)

    def friction(self, known: Belief) -> float:
        """The coefficient, as known."""
        return float(known.mean[self._coefficient])

    def _mean_square(self, known: Belief) -> float:
        coefficient = self._coefficient
        variance = known.covariance[coefficient, coefficient]
        return float(known.mean[coefficient] ** 2 + variance)


class SlidesAtPose:
    """What changes of readings say of slides, with the arm at one command."""

    def __init__(self, mechanism: Mechanism, command_rad: Array, turning_m: Array) -> None:
        """`turning_m` (M,) is the way over which a cable turns to slide back over its pulley."""
        count = mechanism.segment_count
        cables = mechanism.cable_count
        self._by_angle = kinematics.cable_jacobian_m(mechanism, command_rad)
        self._by_joint = self._by_angle.reshape(cables, count, 2)
        pieces = mechanism.piece_length_m
        behind_m_n = (1.0 - _BEFORE_PULLEY) / mechanism.stiffness_n_m
        self._pieces_m_n = behind_m_n[:, None] * pieces / pieces.sum(axis=1, keepdims=True)
        self._behind_m_n = behind_m_n
        self._run_m_n = _BEFORE_PULLEY / mechanism.stiffness_n_m
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
        std_n = np.where(moved, moved_n + _SLIDING_STD * held_n, moved_n + held_n)
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
        guides = _turned(earlier, passed_m.T, self._guides_turn_m, _GUIDE_STD)
        pulley_std = np.where(moved, _SLIDING_STD, _STANDING_STD)
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


def _turned(
    slides: Slides, passed_m: Array, turning_m: Array, sliding_std: float = _SLIDING_STD
) -> Slides:
    """Slides (G, M) after lengths (G, M) of cable have passed: towards the arm if positive.

    The way over which a cable turns is known roughly: the chance that it has not yet turned falls
    exponentially with what has passed.
    """
    kept = np.exp(-np.abs(passed_m) / turning_m)
    square = kept * (slides.std**2 + slides.mean**2) + (1.0 - kept) * (1.0 + sliding_std**2)
    mean = kept * slides.mean + (1.0 - kept) * np.sign(passed_m)
    return Slides(mean, np.sqrt(square - mean**2), slides.common)
