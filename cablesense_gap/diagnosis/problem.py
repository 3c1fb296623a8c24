"""The diagnosis problem: readings beside a simulator, and an explanation that explains them.

Numbers are sought in scaled form, in units of what is typical, so that one step suits them all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.simulator import Simulator, Term, parameters_of
from cablesense_sim.effects.effect import Parameter

RESOLUTION = 0.2
"""Residuals below this share of the sensors' floor are not distinguished."""

SIZE_PRIOR = 3.0
"""Sizes are expected within this many typical ones of zero (one standard deviation)."""

_CHI2_POWER = 1.0 / 3.0


@dataclass(frozen=True)
class Explanation:
    """Effects, fitted, beside the manufacturing tolerances.

    Attributes:
        effects: names in alphabetical order; none for tolerances alone.
        deviations: 95 % half-widths of the values.
        prediction: (R, C) with effects and tolerances.
        without_tolerances: (R, C) with the effects alone.
        columns: (K, R, C) sensitivities to the scaled values, in the order of `values`.
        covariance: (K, K) of the scaled values; zero for those at the end of their range.
        held_out: (R, C) each trial predicted by a fit without its fold.
        held_out_effects: (R, C) the same with the effects alone, without tolerances.
        squares: (T,) sum of squares that this leaves in each trial.
        count: (T,) numbers in each trial.
        sizes: how many of the values are sizes.
        tolerance_chi2: sum of the squares of the tolerances, each in standard deviations.
        prior_distance: of the values from what was expected, in squared deviations.
    """

    effects: tuple[str, ...]
    values: Mapping[Term, float]
    deviations: Mapping[Term, float]
    tolerances: Mapping[Term, float]
    prediction: Array
    without_tolerances: Array
    columns: Array
    covariance: Array
    held_out: Array
    held_out_effects: Array
    squares: Array
    count: Array
    sizes: int
    tolerance_chi2: float
    prior_distance: float

    @property
    def held_out_rmse(self) -> float:
        """Root mean square over all trials, each predicted by a fit without its fold."""
        return float(np.sqrt(self.squares.sum() / self.count.sum()))


@dataclass(frozen=True)
class Problem:
    """One recording beside its simulator.

    Attributes:
        readings: (R, C).
        trial: (R,) 0 to T - 1.
        fold: (T,) trials of one fold are held out together.
        used: (R,) rows that count.
        nominal: (R, C) prediction without any effect.
        tolerance_std: standard deviation of each of the terms.
        tolerance_columns: (K, R, C) sensitivities, in standard deviations.
        sketch: the same of some of the rows, if they suffice to choose among effects that depend
            on the past.
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
    sketch: Sketch | None = None

    @property
    def floor(self) -> float:
        """Root mean square of what the sensors add."""
        return self.simulator.floor

    @cached_property
    def acting_tolerances(self) -> NDArray[np.bool_]:
        """(K,) which tolerances change anything; those of friction do only where there is some."""
        return np.asarray(self.tolerance_columns.any(axis=(1, 2)))

    def squares_by_trial(self, held_out: Array) -> tuple[Array, Array]:
        """(T,) sums of squares that a prediction (R, C) leaves by trial, and of how many."""
        of_row = ((self.readings - held_out) ** 2).sum(-1) * self.used
        every = self.used * float(held_out.shape[1])
        sums = [np.bincount(self.trial, each, len(self.fold)) for each in (of_row, every)]
        return sums[0].astype(float), sums[1].astype(float)

    def cost(self, mean_square: float, tolerance_chi2: float) -> float:
        """Excess over the floor, larger where tolerances would have to be unusually far off.

        The search ranks explanations by it; the posterior weighs both by calibrated powers.
        """
        usual = max(int(self.acting_tolerances.sum()), 1)
        return float(
            excess(mean_square, self.floor) * max(tolerance_chi2 / usual, 1.0) ** _CHI2_POWER
        )

    def cost_of(self, explanation: Explanation) -> float:
        """That of what an explanation leaves on held-out trials."""
        return self.cost(explanation.held_out_rmse**2, explanation.tolerance_chi2)


@dataclass(frozen=True)
class Sketch:
    """A problem of some rows of another.

    Attributes:
        rows: (K,) of the other's, the first, the last and some of every trial.
    """

    rows: NDArray[np.int64]
    problem: Problem

    def explanation(self, whole: Explanation) -> Explanation:
        """One of the other problem as it does on these rows."""
        held_out, problem = whole.held_out[self.rows], self.problem
        squares, count = problem.squares_by_trial(held_out)
        return replace(
            whole,
            prediction=whole.prediction[self.rows],
            without_tolerances=whole.without_tolerances[self.rows],
            columns=whole.columns[:, self.rows],
            held_out=held_out,
            held_out_effects=whole.held_out_effects[self.rows],
            squares=squares,
            count=count,
        )

    def over_all_rows(self, columns: Array) -> Array:
        """(K, R, C) of what is known on these rows, (K, rows, C); straight on between them."""
        every = np.arange(self.rows[-1] + 1)
        after = np.clip(np.searchsorted(self.rows, every), 1, len(self.rows) - 1)
        begin, end = self.rows[after - 1], self.rows[after]
        share = ((every - begin) / (end - begin))[:, None]
        return np.asarray(columns[:, after - 1] * (1.0 - share) + columns[:, after] * share)


def sketched(problem: Problem, simulator: Simulator, rows: NDArray[np.int64]) -> Problem:
    """The problem with a sketch of it, of some rows that `simulator` goes through alone."""
    part = replace(
        problem,
        simulator=simulator,
        readings=problem.readings[rows],
        trial=problem.trial[rows],
        used=problem.used[rows],
        nominal=simulator.predict([{}])[0],
        tolerance_columns=problem.tolerance_columns[:, rows],
    )
    return replace(problem, sketch=Sketch(rows, part))


def prepare(
    simulator: Simulator,
    readings: Array,
    trial: NDArray[np.int64],
    fold: NDArray[np.int64],
    used: NDArray[np.bool_],
) -> Problem:
    """Predict the nominal mechanism and what each tolerance changes of it."""
    nominal = simulator.predict([{}])[0]
    std = {term: p.typical for term, p in parameters_of(simulator.tolerances).items()}
    columns = [simulator.predict([{term: value}])[0] - nominal for term, value in std.items()]
    return Problem(
        simulator=simulator,
        readings=readings,
        trial=np.unique(trial, return_inverse=True)[1],
        fold=fold,
        used=used,
        nominal=nominal,
        tolerance_terms=tuple(std),
        tolerance_std=np.array(list(std.values())),
        tolerance_columns=np.array(columns).reshape(len(columns), *nominal.shape),
    )


def excess(mean_square: float, floor: float) -> float:
    """Root mean square left beyond the floor, never below what can be resolved."""
    beyond = max(mean_square - floor**2, 0.0)
    return float(np.sqrt(beyond + (RESOLUTION * floor) ** 2))


def is_logarithmic(parameter: Parameter) -> bool:
    """Times and lengths that are never zero are sought by their logarithm."""
    return parameter.role == "shape" and parameter.low > 0.0


def to_scaled(parameter: Parameter, value: float) -> float:
    """The value as the search has it."""
    if parameter.relative:
        return float(np.log1p(value) / np.log1p(parameter.typical))
    return float(np.log(value)) if is_logarithmic(parameter) else value / parameter.typical


def from_scaled(parameter: Parameter, scaled: float) -> float:
    """The value that the search means, within the plausible range."""
    if parameter.relative:
        value = float(np.expm1(scaled * np.log1p(parameter.typical)))
    else:
        value = np.exp(scaled) if is_logarithmic(parameter) else scaled * parameter.typical
    return float(np.clip(value, parameter.low, parameter.high))


def unit_of(parameter: Parameter, value: float) -> float:
    """By how much the value moves as the scaled one moves by one."""
    if parameter.relative:
        return float((1.0 + value) * np.log1p(parameter.typical))
    return value if is_logarithmic(parameter) else parameter.typical


def prior_precision(parameter: Parameter) -> float:
    """Of the scaled value about zero for a size, about its start for a shape."""
    return SIZE_PRIOR**-2 if parameter.role == "size" else 1.0
