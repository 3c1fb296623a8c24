"""What is known of the slides of cables, and what friction therefore adds to their tensions.

The slide u times the coefficient μ is the carried friction ε. With a coefficient that is known to
its mean and variance only,

    E ε = E[u] E[μ],    cov(ε, x) = E[u] cov(μ, x),
    cov(ε_a, ε_b) = E[u_a] E[u_b] var μ,    var ε = E[u]² var μ + var u E[μ²],

where x is any other parameter, and slides are independent of μ.

Slides of the unloaded machine follow from its motion, which passes cable over the guides, and
those under a load from changes of the readings (`slides_under_load`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_contact.cable_routes import CableRoutes
from cablesense_contact.slides import Belief, KnownLengths, Slides, play_compliance_m_n, played
from cablesense_contact.slides_under_load import SlidesAtPose, SlidesUnderLoad
from cablesense_sim.parameter_groups import GroupedParameters

_TURNING_RAD = float(np.deg2rad(1.0))
"""Over so much of its last way the direction of a motion counts."""
_STEPS_OF_MOTION = 16
"""In which a motion is followed: on a straight way of the joints a cable may turn back."""
_TRIFLE = 0.1
"""Friction counts if it makes more than this share of the change that shows that a cable has
moved."""
_SAME_SLIDE_STEP = 1.0 / 16.0
"""Slides that are nearer to each other count as the same."""
_FREED_STD = 0.05
"""Deviation of slides after a breath."""
_LEAST_PLAY_M = 1e-12
"""Play of a guide over which a cable goes straight: something is divided by it."""


@dataclass(frozen=True)
class LastWay:
    """The way of the commands of an unloaded machine, as far back as it matters to slides.

    Attributes:
        commands_rad: each (C,), the present one last; empty where nothing is known yet.
    """

    commands_rad: tuple[Array, ...] = ()

    def to(self, command_rad: Array) -> LastWay:
        """The way on to the next command (C,)."""
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
        """(C,) where the motion to the present command came from; None if that is not known."""
        return self.commands_rad[0] if len(self.commands_rad) > 1 else None


class FrictionParameters(NamedTuple):
    """Where friction stands among the parameters of a machine with M cables and G guides.

    Attributes:
        carried: of what friction carries, M at each guide.
        coefficient: of the coefficient.
        exists: (G M,) 1 where something may be carried, else 0.
        expected: root mean square of the coefficient, before readings tell more.
    """

    carried: slice
    coefficient: int
    exists: Array
    expected: float

    @classmethod
    def of(cls, parameters: GroupedParameters) -> FrictionParameters:
        """By the tolerances of a machine."""
        carried = parameters.carried_friction
        coefficient = parameters.slices["friction"].start
        prior_std = parameters.prior_std
        return cls(
            carried=carried,
            coefficient=coefficient,
            exists=(prior_std[carried] > 0.0).astype(float),
            expected=math.hypot(parameters.prior_mean[coefficient], prior_std[coefficient]),
        )


class CableSlides:
    """The slides of cables by what has moved them; a `felt.KnownSlides`.

    Attributes:
        unknown: the machine has moved, who knows in which direction.
        freed: after a breath, which takes friction out of all readings.
    """

    def __init__(self, routes: CableRoutes, friction: FrictionParameters) -> None:
        """For the routes of M cables over G guides, and where their friction stands."""
        self._routes = routes
        self._carried = friction.carried
        self._coefficient = friction.coefficient
        self._exists = friction.exists
        cables, pieces = routes.compliance_m_n.shape
        # parameters of a machine without friction may have no guides at all
        shape = (pieces - 1 if friction.exists.size else 0, cables)
        nothing = np.zeros(shape)
        self.unknown = Slides(nothing, np.ones(shape))
        self.freed = Slides(nothing, np.full(shape, _FREED_STD))
        self._pretension_n = float(np.max(routes.pretension_n, initial=0.0))
        play_m_n = play_compliance_m_n(routes.compliance_m_n)
        self._play_m_rad = 2.0 * friction.expected * routes.pretension_n[:, None] * play_m_n

    def after_motion(self, from_rad: Array, to_rad: Array) -> Slides:
        """Those of the unloaded machine after a straight motion between two commands (C,).

        What passes a guide is what the pieces behind it take up.
        """
        slides = self.unknown
        if not (self._exists.any() and self._routes.are_followed):
            return slides
        way = self._routes.on_the_way(from_rad, to_rad, _STEPS_OF_MOTION)
        behind_m = way.length_m[..., :0:-1].cumsum(axis=-1)[..., ::-1]
        wrap_rad = 0.5 * (way.wrap_rad[1:] + way.wrap_rad[:-1])
        for passed_m, turned_rad in zip(np.diff(behind_m, axis=0), wrap_rad, strict=True):
            play_m = np.maximum(self._play_m_rad * turned_rad, _LEAST_PLAY_M)
            passed = KnownLengths(passed_m.T, np.zeros_like(passed_m.T))
            slides = played(slides, passed, play_m.T)
        return slides

    def matter(self, known: Belief) -> bool:
        """Whether friction makes more of a reading than a trifle of a change that shows."""
        if not self._routes.are_followed:
            return False
        friction_n = self._pretension_n * math.sqrt(self._mean_square(known))
        return friction_n > _TRIFLE * self._routes.moved_n

    def under_load(
        self, command_rad: Array, untouched_n: Array, known: Belief, arrived: Slides | None = None
    ) -> SlidesUnderLoad:
        """Follows readings at one command (C,), from those of the untouched machine (M,) on.

        `arrived` are the slides with which the machine came there, by default unknown.
        """
        pose = SlidesAtPose(self._routes, command_rad)
        return SlidesUnderLoad.begin(
            pose,
            self.unknown if arrived is None else arrived,
            untouched_n,
            self._routes.moved_n,
            friction=float(known.mean[self._coefficient]),
        )

    def rounded(self, slides: Slides) -> tuple[bytes, Slides]:
        """Slides to a sixteenth, and a key of them: nearly the same ones are one."""
        mean = np.rint(slides.mean / _SAME_SLIDE_STEP)
        std = np.maximum(np.rint(slides.std / _SAME_SLIDE_STEP), 1.0)
        key = b"".join(part.astype(np.int8).tobytes() for part in (mean, std))
        return key, Slides(_SAME_SLIDE_STEP * mean, _SAME_SLIDE_STEP * std)

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
        together = of_coefficient[self._coefficient] * np.outer(slide, slide)
        covariance[part, part] = together + np.diag(self.alone(known, slides))
        return Belief(mean, covariance)

    def by_lasting(self, slope: Array, slides: Slides) -> Array:
        """Slopes (D, P) of readings by parameters, without what friction carries.

        They have the coefficient's share in it instead.
        """
        slide = slides.mean.ravel() * self._exists
        lasting = slope.copy()
        lasting[:, self._coefficient] += slope[:, self._carried] @ slide
        lasting[:, self._carried] = 0.0
        return lasting

    def alone(self, known: Belief, slides: Slides) -> Array:
        """(G M,) variances of what is carried by the slides alone, in their order."""
        variance = (slides.std.ravel() * self._exists) ** 2
        return np.asarray(self._mean_square(known) * variance)

    def _mean_square(self, known: Belief) -> float:
        coefficient = self._coefficient
        variance = known.covariance[coefficient, coefficient]
        return float(known.mean[coefficient] ** 2 + variance)
