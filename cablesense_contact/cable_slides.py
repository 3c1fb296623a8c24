"""What is known of an arm's slides, and what friction therefore adds to its tensions.

The slide u times the coefficient μ is the carried friction ε. With a coefficient that is known to
its mean and variance only,

    E ε = E[u] E[μ],    cov(ε, x) = E[u] cov(μ, x),
    cov(ε_a, ε_b) = E[u_a] E[u_b] var μ,    var ε = E[u]² var μ + var u E[μ²],

where x is any other parameter, and slides are independent of μ.

Slides of the unloaded arm follow from its motion, which passes cable over the guides, and those
under a load from changes of the readings (`slides_under_load`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cablesense_base import Array
from cablesense_contact.slides import Belief, Slides, turned
from cablesense_contact.slides_under_load import SlidesAtPose, SlidesUnderLoad
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.replay import reading_variance_n2
from cablesense_sim.uncertain_arm import arm_parameters, cable_friction

_MOVED_STD = 5.0
"""A cable has moved if its reading has changed by this many deviations of a reading."""
_TURNING_RAD = float(np.deg2rad(1.0))
"""Over so much of its last way the direction of a motion counts."""
_STEPS_OF_MOTION = 16
"""In which a motion is followed: on a straight way of the joints a cable may turn back."""
_TRIFLE = 0.1
"""Friction counts if it makes more than this share of the change that shows that a cable has
moved."""
_ROUNDED = 1.0 / 16.0
"""Slides that are nearer to each other count as the same."""
_FREED_STD = 0.05
"""Deviation of slides after a breath."""


@dataclass(frozen=True)
class LastWay:
    """The way of the commands of an unloaded arm, as far back as it matters to slides.

    Attributes:
        commands_rad: each (2N,), the present one last; empty where nothing is known yet.
    """

    commands_rad: tuple[Array, ...] = ()

    def to(self, command_rad: Array) -> LastWay:
        """The way on to the next command (2N,)."""
        way_rad = [*self.commands_rad, command_rad]
        while len(way_rad) > 2:
            back_rad = np.abs(way_rad[1] - command_rad).max()
            if back_rad < _TURNING_RAD:
                break
            del way_rad[0]
        return LastWay(tuple(way_rad))

    @property
    def forgotten(self) -> LastWay:
        """The way once something else has moved the cables: none but the present command."""
        return LastWay(self.commands_rad[-1:])

    @property
    def came_from_rad(self) -> Array | None:
        """(2N,) where the motion to the present command came from; None if that is not known."""
        return self.commands_rad[0] if len(self.commands_rad) > 1 else None


class CableSlides:
    """The slides of an arm's cables, by what has moved them.

    Attributes:
        unknown: the arm has moved, who knows in which direction.
        freed: after a breath, which takes friction out of all readings.
    """

    def __init__(self, arm: Arm) -> None:
        """For the arm of a file."""
        mechanism = mechanism_of(arm)
        parameters = arm_parameters(arm)
        run_compliance = cable_friction(arm).run_compliance
        self._mechanism = mechanism
        self._moved_n = _MOVED_STD * math.sqrt(reading_variance_n2(arm.sensors))
        self._before_pulley = run_compliance / (1.0 + run_compliance)
        self._carried = parameters.carried_friction
        self._coefficient = parameters.slices["friction"].start
        self._exists = (parameters.prior_std[self._carried] > 0.0).astype(float)
        shape = (mechanism.segment_count + 1, mechanism.cable_count)
        nothing = np.zeros(shape)
        self.unknown = Slides(nothing, np.ones(shape), nothing)
        self.freed = Slides(nothing, np.full(shape, _FREED_STD), nothing)
        self._pretension_n = float(np.max(mechanism.pretension_n))
        # to slide back, a cable that carries ε = μ has to be stretched until it carries -μ
        coefficient = math.hypot(
            parameters.prior_mean[self._coefficient], parameters.prior_std[self._coefficient]
        )
        behind_m_n = (1.0 - self._before_pulley) / mechanism.stiffness_n_m
        turning_m = 2.0 * coefficient * mechanism.pretension_n * behind_m_n
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
            slides = turned(slides, passed_m, self._turning_m)
        return slides

    def matter(self, known: Belief) -> bool:
        """Whether friction makes more of a reading than a trifle of a change that shows."""
        friction_n = self._pretension_n * math.sqrt(self._mean_square(known))
        return friction_n > _TRIFLE * self._moved_n

    def under_load(
        self, command_rad: Array, untouched_n: Array, known: Belief, arrived: Slides | None = None
    ) -> SlidesUnderLoad:
        """Follows readings at one command (2N,), from those of the untouched arm (M,) on.

        `arrived` are the slides with which the arm came there, by default unknown.
        """
        pose = SlidesAtPose(self._mechanism, command_rad, self._turning_m, self._before_pulley)
        return SlidesUnderLoad.begin(
            pose,
            self.unknown if arrived is None else arrived,
            untouched_n,
            self._moved_n,
            friction=float(known.mean[self._coefficient]),
        )

    def rounded(self, slides: Slides) -> tuple[bytes, Slides]:
        """Slides to a sixteenth, and a key of them: nearly the same ones are one."""
        mean = np.rint(slides.mean / _ROUNDED)
        std = np.maximum(np.rint(slides.std / _ROUNDED), 1.0)
        common = np.rint(slides.common / _ROUNDED)
        key = b"".join(part.astype(np.int8).tobytes() for part in (mean, std, common))
        return key, Slides(_ROUNDED * mean, _ROUNDED * std, _ROUNDED * common)

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

    def _mean_square(self, known: Belief) -> float:
        coefficient = self._coefficient
        variance = known.covariance[coefficient, coefficient]
        return float(known.mean[coefficient] ** 2 + variance)
