"""What the diagnosis works on: readings by trial, and the sensitivities to tolerances.

One explanation of the gap: effects with their numbers, and what they leave unexplained.

Parameters in units of what is typical, so that one step length suits them all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_base.arrays import Array
from cablesense_gap.simulator import Simulator, Term
from cablesense_sim.effects.effect import Parameter

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


FOLDS = 5

_STRAIN = 1.0 / 3.0


@dataclass(frozen=True)
class Course:
    """One recording beside its simulator.

    Attributes:
        simulator: put through this very recording.
        readings: (R, C).
        trial: (R,) 0 to T - 1.
        fold: (T,) trials of one fold are held out together.
        used: (R,) rows that count.
        nominal: (R, C) prediction without any effect.
        tolerance_terms: of what a workshop leaves.
        tolerance_std: of each of them.
        tolerance_columns: (K, R, C) sensitivities, in standard deviations.
    """

    simulator: Simulator
    readings: Array
    trial: NDArray[np.int64]
    fold: NDArray[np.int64]
    used: NDArray[np.bool_]
    nominal: Array
    tolerance_terms: tuple[Term, ...]
    tolerance_std: Array
    tolerance_columns: Array

    @property
    def floor(self) -> float:
        """Root mean square of what the sensors add."""
        return self.simulator.floor

    @property
    def usual_strain(self) -> float:
        """Sum of the squares of all tolerances, in standard deviations, of a careful workshop."""
        return float(max(len(self.tolerance_terms), 1))

    def cost(self, mean_square: float, strain: float) -> float:
        """What is left beyond the floor, the dearer the farther tolerances have to be off.

        By this the search ranks explanations; the belief weighs both by calibrated powers.
        """
        strained = max(strain / self.usual_strain, 1.0)
        return float(excess(mean_square, self.floor) * strained**_STRAIN)

    def cost_of(self, hypothesis: Hypothesis) -> float:
        """That of what a hypothesis leaves on held-out trials."""
        return self.cost(hypothesis.held_out_rmse**2, hypothesis.strain)


def prepare(
    simulator: Simulator,
    readings: Array,
    trial: NDArray[np.int64],
    fold: NDArray[np.int64],
    used: NDArray[np.bool_],
) -> Course:
    """Predict the nominal mechanism and what each tolerance changes of it."""
    nominal = simulator.predict([{}])[0]
    terms = [
        (term, parameter.typical)
        for candidate in simulator.tolerances
        for place in candidate.places
        for term, parameter in zip(candidate.terms(place), candidate.parameters, strict=True)
    ]
    columns = [simulator.predict([{term: std}])[0] - nominal for term, std in terms]
    return Course(
        simulator=simulator,
        readings=readings,
        trial=np.unique(trial, return_inverse=True)[1],
        fold=fold,
        used=used,
        nominal=nominal,
        tolerance_terms=tuple(term for term, _ in terms),
        tolerance_std=np.array([std for _, std in terms]),
        tolerance_columns=np.array(columns).reshape(len(columns), *nominal.shape),
    )


SIZE_PRIOR = 3.0
"""Sizes are expected within this many typical ones of zero (one standard deviation)."""


def is_logarithmic(parameter: Parameter) -> bool:
    """Times and lengths that are never zero are sought by their logarithm."""
    return parameter.role == "shape" and parameter.low > 0.0


def to_scaled(parameter: Parameter, value: float) -> float:
    """The value as the search sees it."""
    if is_logarithmic(parameter):
        return float(np.log(value))
    return value / parameter.typical


def from_scaled(parameter: Parameter, scaled: float) -> float:
    """The value that the search means, within the plausible range."""
    value = np.exp(scaled) if is_logarithmic(parameter) else scaled * parameter.typical
    return float(np.clip(value, parameter.low, parameter.high))


def prior_precision(parameter: Parameter) -> float:
    """Of the scaled value about zero for a size, about its start for a shape."""
    return SIZE_PRIOR**-2 if parameter.role == "size" else 1.0
