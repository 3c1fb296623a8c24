"""The slides of a machine's tendons: anything between both ways, in every pose anew.

How far a tendon has slid at its pulleys is followed on arms of the arm file (`cable_slides`). Of
other machines it is a tolerance: a reading in each pose has a friction of its own, and readings
teach the coefficient alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cablesense_base import Array
from cablesense_contact.slides import Belief, Slides

_FREED_STD = 0.05
"""Deviation of slides after a breath."""


@dataclass(frozen=True)
class StandingSlides:
    """Slides that readings under a load do not tell; a `felt.SlidesUnderLoad`."""

    slides: Slides

    def after(self, reading_n: Array) -> StandingSlides:
        """The same."""
        del reading_n
        return self


class CarriedSlides:
    """A `felt.KnownSlides` of K tendons.

    Attributes:
        unknown, freed: see there.
    """

    def __init__(self, carried: slice, coefficient: int) -> None:
        """Where the parameters stand: what friction carries, and its coefficient."""
        self._carried = carried
        self._coefficient = coefficient
        shape = (1, carried.stop - carried.start)
        nothing = np.zeros(shape)
        self.unknown = Slides(nothing, np.full(shape, 3.0**-0.5), nothing)
        self.freed = Slides(nothing, np.full(shape, _FREED_STD), nothing)

    def matter(self, known: Belief) -> bool:
        """Never: nothing that moves the tendons tells of their slides."""
        del known
        return False

    def after_motion(self, from_rad: Array, to_rad: Array) -> Slides:
        """Unknown."""
        del from_rad, to_rad
        return self.unknown

    def under_load(
        self, command_rad: Array, untouched_n: Array, known: Belief, arrived: Slides | None = None
    ) -> StandingSlides:
        """As they were before."""
        del command_rad, untouched_n, known
        return StandingSlides(self.unknown if arrived is None else arrived)

    def rounded(self, slides: Slides) -> tuple[bytes, Slides]:
        """There are two kinds only."""
        return slides.std.tobytes(), slides

    def carried(self, known: Belief, slides: Slides) -> Belief:
        """What is known with these slides, whose mean is zero: variances E[μ²] var u."""
        mean = known.mean.copy()
        covariance = known.covariance.copy()
        part = self._carried
        mean[part] = 0.0
        covariance[part] = 0.0
        covariance[:, part] = 0.0
        numbers = np.arange(part.start, part.stop)
        covariance[numbers, numbers] = self.alone(known, slides)
        return Belief(mean, covariance)

    def by_lasting(self, slope: Array, slides: Slides) -> Array:
        """Slopes (D, P) without what friction carries, whose mean is zero."""
        del slides
        lasting = slope.copy()
        lasting[:, self._carried] = 0.0
        return lasting

    def alone(self, known: Belief, slides: Slides) -> Array:
        """(K,) variances of what is carried."""
        variance = known.covariance[self._coefficient, self._coefficient]
        mean_square = known.mean[self._coefficient] ** 2 + variance
        return np.asarray(mean_square * slides.std.ravel() ** 2)
