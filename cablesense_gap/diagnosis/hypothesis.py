"""One explanation of the gap: effects with their numbers, and what they leave unexplained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.simulator import Array, Term

RESOLUTION = 0.2
"""What is left is not told apart below this share of the sensors' floor."""


@dataclass(frozen=True)
class Hypothesis:
    """Effects, fitted, beside the tolerances of a workshop.

    Attributes:
        effects: names in alphabetical order; none for tolerances alone.
        values: of every number of these effects.
        deviations: 95 % half-widths of the same.
        tolerances: values of what a workshop leaves.
        prediction: (R, C) with effects and tolerances.
        without_tolerances: (R, C) with the effects alone.
        columns: (K, R, C) sensitivities to the scaled values, in the order of `values`.
        held_out: (R, C) each trial predicted by a fit without its fold.
        squares: (T,) sum of squares that this leaves in each trial.
        count: (T,) numbers in each trial.
        sizes: how many of the values are sizes.
        strain: sum of the squares of the tolerances, each in standard deviations.
        strangeness: how far the values lie from what was expected, in squared deviations.
    """

    effects: tuple[str, ...]
    values: Mapping[Term, float]
    deviations: Mapping[Term, float]
    tolerances: Mapping[Term, float]
    prediction: Array
    without_tolerances: Array
    columns: Array
    held_out: Array
    squares: Array
    count: Array
    sizes: int
    strain: float
    strangeness: float

    @property
    def held_out_rmse(self) -> float:
        """Root mean square over all trials, each predicted by a fit without its fold."""
        return float(np.sqrt(self.squares.sum() / self.count.sum()))

    @property
    def places(self) -> tuple[str, ...]:
        """Where the effects sit."""
        return tuple(dict.fromkeys(term.place for term in self.values))


def excess(mean_square: float | NDArray[np.float64], floor: float) -> float:
    """What is left beyond the floor, never below what can be resolved."""
    beyond = np.maximum(mean_square - floor**2, 0.0)
    return float(np.sqrt(beyond + (RESOLUTION * floor) ** 2))
