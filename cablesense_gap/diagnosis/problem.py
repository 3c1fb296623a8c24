"""The diagnosis problem: readings and a simulator. A hypothesis is a fitted set of effects.

Fits use scaled values, in units of a typical one, so that one step suits all parameters.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import comb

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.diagnosis.linear_fit import products
from cablesense_gap.simulator import Assignment, Simulator, Term, parameters_of, small_changes
from cablesense_sim.effects.effect import Parameter

RESOLUTION = 0.2
"""Residuals below this share of the sensors' floor are not distinguished."""

_UNSEEN = 0.1
"""Share of the floor below which a change by nuisance parameters is left out: half of what
residuals can show."""
_WORTH_MIXING = 0.2
"""Share of the directions to be left out, from which on nuisance parameters are fitted by
directions."""

EFFECT_WORTH = 1.08
"""The factor by which an effect must make the cost smaller."""
PLACE_WORTH = 1.04
"""The factor by which each place of an effect must make it smaller."""
CHOICE_WORTH = 0.02
"""The power of the number of ways to choose these places: many choices fit chance better."""
_EXPLAINED_RATIO = 1.5
"""Of the least cost that can be resolved: a hypothesis up to there leaves nothing to explain."""
_SHOWN_FLOORS = 0.5
"""Noise floors (RMS) by which an effect must make the residual smaller to be shown."""
_CHANCE_QUANTILE = 1.28
"""Standard deviations of a normal variable that it exceeds in 10 % of draws."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Effects with places and values, fitted together with the manufacturing tolerances.

    Attributes:
        effects: names in alphabetical order; none for nuisance parameters alone.
        deviations: 95 % half-widths of the values.
        prediction: (R, C) with effects and nuisance parameters.
        without_nuisance: (R, C) with the effects alone.
        columns: (K, R, C) sensitivities to the scaled values, in the order of `values`.
        covariance: (K, K) of the scaled values; zero for those at the end of their range.
        held_out: (R, C) each trial predicted with effects fitted without its fold.
        held_out_effects: (R, C) the same with the effects alone, without nuisance parameters.
        squares: (T,) sum of squared held-out residuals of each trial.
        count: (T,) numbers in each trial.
        sizes: how many of the values are sizes that change a reading.
        nuisance_chi2: sum of the squares of the nuisance parameters, each in standard deviations.
        nuisance_count: of the directions in which they were fitted, whose sum it is.
        log_prior_penalty: by how much its sizes and places are less probable than usual ones,
            natural logarithm.
    """

    effects: tuple[str, ...]
    values: Mapping[Term, float]
    deviations: Mapping[Term, float]
    nuisance: Mapping[Term, float]
    prediction: Array
    without_nuisance: Array
    columns: Array
    covariance: Array
    held_out: Array
    held_out_effects: Array
    squares: Array
    count: Array
    sizes: int
    nuisance_chi2: float
    nuisance_count: int
    log_prior_penalty: float = 0.0

    @property
    def locations(self) -> list[tuple[str, str]]:
        """Each effect with each of its places, in the order of the values."""
        return list(dict.fromkeys(term[:2] for term in self.values))

    def is_clearly_better_than(self, other: Hypothesis) -> bool:
        """Whether it leaves less on held-out trials by more than chance over them (90 %)."""
        gain = other.squares - self.squares
        return bool(gain.sum() > _CHANCE_QUANTILE * np.sqrt(len(gain)) * gain.std())

    @property
    def held_out_rmse(self) -> float:
        """Root mean square over all trials, each with effects fitted without its fold."""
        return float(np.sqrt(self.squares.sum() / self.count.sum()))


@dataclass(frozen=True)
class Past:
    """The past's part in readings, as it shows where commands and load return.

    Attributes:
        rms: by which readings differ there, an upper bound.
        rows: (R,) which rows are in such states.
    """

    rms: float
    rows: NDArray[np.bool_]


@dataclass(frozen=True)
class Problem:
    """One recording and its simulator.

    Attributes:
        readings: (R, C).
        trial: (R,) 0 to T - 1.
        fold: (T,) trials of one fold are held out together.
        used: (R,) rows that count.
        nominal: (R, C) prediction without any effect.
        nuisance_std: (K,) standard deviation of each of the K terms.
        nuisance_mix: (K, J) directions in which fits move them: deviations of the terms, in
            standard deviations, by coefficients that are normal and independent.
        nuisance_columns: (J, R, C) sensitivities to these coefficients.
        nuisance_remainder: (R, C) change by nuisance parameters beyond these, where the columns
            were taken.
        nuisance_at: the nuisance parameters where they were; without any, the nominal ones.
        nuisance_change: (R, C) change of the nominal prediction by them.
        past: by how much readings depend on it; None if unknown.
        far_off: standard deviations beyond which one nuisance parameter imitates an effect.
        subsample: the same for some of the rows, if these suffice to choose among effects that
            depend on history.
    """

    simulator: Simulator
    readings: Array
    trial: NDArray[np.int64]
    fold: NDArray[np.int64]
    used: NDArray[np.bool_]
    nominal: Array
    nuisance_terms: tuple[Term, ...]
    nuisance_std: Array
    nuisance_mix: Array
    nuisance_columns: Array
    nuisance_remainder: Array
    nuisance_at: Assignment
    nuisance_change: Array
    past: Past | None = None
    far_off: float = 5.0
    subsample: Subsample | None = None

    @property
    def floor(self) -> float:
        """RMS of what the sensors add to a perfect reading."""
        return self.simulator.floor

    def predict(self, variants: Sequence[Assignment]) -> Array:
        """Readings (P, R, C) of P variants of the nominal mechanism.

        An effect changes them as it does together with the nuisance parameters about which they
        are linear.
        """
        if not self.nuisance_at:
            return self.simulator.predict(variants)
        beside = [{**self.nuisance_at, **variant} for variant in variants]
        return self.simulator.predict(beside) - self.nuisance_change

    @cached_property
    def nuisance_gram(self) -> Array:
        """(T, J, J) of the nuisance parameters' columns in the used rows of each trial."""
        nothing = np.zeros_like(self.readings)
        return products(self.nuisance_columns, nothing, self.trial, self.used).gram

    @cached_property
    def acting_directions(self) -> NDArray[np.bool_]:
        """(J,) in which directions nuisance parameters act; some do so only with friction."""
        return np.asarray(self.nuisance_columns.any(axis=(1, 2)))

    def nuisance_values_of(self, coefficients: Array) -> dict[Term, float]:
        """Those that change anything, of the coefficients (J,) of a fit."""
        values = self.nuisance_std * (self.nuisance_mix @ coefficients)
        acting = np.flatnonzero((self.nuisance_mix * self.acting_directions != 0.0).any(axis=1))
        return {self.nuisance_terms[k]: float(values[k]) for k in acting}

    def coefficients_of(self, nuisance: Assignment) -> Array:
        """(J,) of nuisance parameters, without what these change less than can be resolved."""
        values = np.array([nuisance.get(term, 0.0) for term in self.nuisance_terms])
        return np.asarray((values / self.nuisance_std) @ self.nuisance_mix)

    @cached_property
    def parameters(self) -> dict[Term, Parameter]:
        """Every number of the candidates in every place."""
        return parameters_of(self.simulator.candidates)

    @cached_property
    def _place_counts(self) -> dict[str, int]:
        counts: Counter[str] = Counter()
        for candidate in self.simulator.candidates:
            counts[candidate.effect] += len(candidate.places)
        return counts

    def penalty(self, counts: Mapping[str, int]) -> float:
        """Factor on the cost, from the number of places of each effect."""
        factor = 1.0
        for effect, count in counts.items():
            places = self._place_counts[effect]
            choices = sum(comb(places, k + 1) for k in range(count))
            factor *= EFFECT_WORTH * PLACE_WORTH**count * float(choices) ** CHOICE_WORTH
        return factor

    def score(self, hypothesis: Hypothesis) -> float:
        """The cost of a hypothesis with its penalty: the search minimises it."""
        return self.cost_of(hypothesis) * self.penalty(Counter(e for e, _ in hypothesis.locations))

    def squares_by_trial(self, held_out: Array) -> tuple[Array, Array]:
        """(T,) sums of squared residuals of a prediction (R, C), and (T,) how many they are."""
        of_row = ((self.readings - held_out) ** 2).sum(-1) * self.used
        row_counts = self.used * float(held_out.shape[1])
        sums = [np.bincount(self.trial, each, len(self.fold)) for each in (of_row, row_counts)]
        return sums[0].astype(float), sums[1].astype(float)

    def cost(self, mean_square: float, nuisance_chi2: float) -> float:
        """RMS residual beyond the floor, larger if nuisance parameters would have to be far off.

        The search ranks hypotheses by it. It grows with small surpluses of nuisance parameters as
        the posterior does, but less with large ones: linear columns exaggerate these.
        """
        usual = max(int(self.acting_directions.sum()), 1)
        return noise_corrected_rms(mean_square, self.floor) * max(nuisance_chi2 / usual, 1.0)

    def cost_of(self, hypothesis: Hypothesis) -> float:
        """The cost of a hypothesis on held-out trials."""
        return self.cost(hypothesis.held_out_rmse**2, hypothesis.nuisance_chi2)

    def worst_nuisance(self, hypothesis: Hypothesis) -> float:
        """The largest nuisance parameter of a hypothesis, in standard deviations."""
        std = dict(zip(self.nuisance_terms, self.nuisance_std, strict=True))
        off = (abs(value) / std[term] for term, value in hypothesis.nuisance.items())
        return max(off, default=0.0)

    def has_usual_nuisance(self, hypothesis: Hypothesis) -> bool:
        """Whether none of its nuisance parameters is so far off that it imitates an effect."""
        return self.worst_nuisance(hypothesis) <= self.far_off

    def is_explained(self, hypothesis: Hypothesis) -> bool:
        """Whether its residual is near the least that can be resolved, its nuisance usual."""
        near = self.cost_of(hypothesis) <= _EXPLAINED_RATIO * noise_corrected_rms(0.0, self.floor)
        return near and self.has_usual_nuisance(hypothesis)

    def shows(self, hypothesis: Hypothesis, part: Hypothesis) -> bool:
        """Whether a hypothesis explains clearly more than a part of it.

        The least is half a noise floor and more than chance. It also does if the part needs a
        nuisance parameter that imitates an effect.
        """
        worst = max(self.far_off, self.worst_nuisance(hypothesis))
        if self.worst_nuisance(part) > worst:
            return True
        more = part.held_out_rmse**2 - hypothesis.held_out_rmse**2
        return more > (_SHOWN_FLOORS * self.floor) ** 2 and hypothesis.is_clearly_better_than(part)


@dataclass(frozen=True)
class Subsample:
    """A problem with some of the rows of another.

    Attributes:
        rows: (K,) of the other problem: the first, the last and some of every trial.
    """

    rows: NDArray[np.int64]
    problem: Problem

    def hypothesis(self, whole: Hypothesis) -> Hypothesis:
        """A hypothesis of the other problem on these rows."""
        held_out = whole.held_out[self.rows]
        problem = self.problem
        squares, count = problem.squares_by_trial(held_out)
        return replace(
            whole,
            prediction=whole.prediction[self.rows],
            without_nuisance=whole.without_nuisance[self.rows],
            columns=whole.columns[:, self.rows],
            held_out=held_out,
            held_out_effects=whole.held_out_effects[self.rows],
            squares=squares,
            count=count,
        )

    def over_all_rows(self, columns: Array) -> Array:
        """(K, R, C) columns from (K, rows, C), linear between these rows."""
        all_rows = np.arange(self.rows[-1] + 1)
        after = np.clip(np.searchsorted(self.rows, all_rows), 1, len(self.rows) - 1)
        begin = self.rows[after - 1]
        end = self.rows[after]
        share = ((all_rows - begin) / (end - begin))[:, None]
        return np.asarray(columns[:, after - 1] * (1.0 - share) + columns[:, after] * share)


def subsampled(problem: Problem, simulator: Simulator, rows: NDArray[np.int64]) -> Problem:
    """The problem with a subsample: `simulator` simulates these rows alone."""
    part = replace(
        problem,
        simulator=simulator,
        readings=problem.readings[rows],
        trial=problem.trial[rows],
        used=problem.used[rows],
        nominal=simulator.predict([{}])[0],
        nuisance_columns=problem.nuisance_columns[:, rows],
        nuisance_remainder=problem.nuisance_remainder[rows],
        nuisance_change=problem.nuisance_change[rows],
    )
    return replace(problem, subsample=Subsample(rows, part))


def prepare(
    simulator: Simulator,
    readings: Array,
    trial: NDArray[np.int64],
    fold: NDArray[np.int64],
    used: NDArray[np.bool_],
) -> Problem:
    """Predict the nominal mechanism, and the change by nuisance parameters."""
    nominal = simulator.predict([{}])[0]
    std = {term: p.typical for term, p in parameters_of(simulator.tolerances).items()}
    columns = np.zeros((0, *nominal.shape))
    if std:
        alone = [{term: value} for term, value in std.items()]
        columns = small_changes(simulator, {}, alone)
    mix = nuisance_directions(columns[:, used], simulator.floor)
    return Problem(
        simulator=simulator,
        readings=readings,
        trial=np.unique(trial, return_inverse=True)[1],
        fold=fold,
        used=used,
        nominal=nominal,
        nuisance_terms=tuple(std),
        nuisance_std=np.array(list(std.values())),
        nuisance_mix=mix,
        nuisance_columns=np.tensordot(mix.T, columns, axes=1),
        nuisance_remainder=np.zeros_like(nominal),
        nuisance_at={},
        nuisance_change=np.zeros_like(nominal),
    )


def nuisance_directions(columns: Array, floor: float) -> Array:
    """(K, J) orthonormal directions of K nuisance parameters that columns (K, R, C) distinguish.

    Many nuisance parameters of an arm change readings alike. With independent normal priors of
    their own, any orthonormal directions have such priors too. Those directions are left out that
    together are expected to change the readings by less than `_UNSEEN` of the floor. Nuisance
    parameters that change nothing now may do so with friction, and are directions of their own. So
    are all if no more than a few directions would be left out.
    """
    count = len(columns)
    acts = columns.any(axis=(1, 2))
    flat = columns[acts].reshape(int(acts.sum()), columns[0].size if count else 0)
    squares, vectors = np.linalg.eigh(flat @ flat.T)
    left_out = np.cumsum(squares) < (_UNSEEN * floor) ** 2 * flat.shape[1]
    if left_out.sum() < _WORTH_MIXING * count:
        return np.eye(count)
    kept = vectors[:, ~left_out][:, ::-1]
    inactive = np.eye(count)[:, ~acts]
    mix = np.zeros((count, kept.shape[1] + inactive.shape[1]))
    mix[acts, : kept.shape[1]] = kept
    mix[:, kept.shape[1] :] = inactive
    return mix


def noise_corrected_rms(mean_square: float, floor: float) -> float:
    """RMS residual beyond the floor, at least what can be resolved."""
    beyond = max(mean_square - floor**2, 0.0)
    return float(np.sqrt(beyond + (RESOLUTION * floor) ** 2))


def is_logarithmic(parameter: Parameter) -> bool:
    """Times and lengths that are never zero are fitted by their logarithm."""
    return parameter.role == "shape" and parameter.low > 0.0


def to_scaled(parameter: Parameter, value: float) -> float:
    """The value in typical sizes, or its logarithm where it is never zero."""
    if parameter.relative:
        return float(np.log1p(value) / np.log1p(parameter.typical))
    return float(np.log(value)) if is_logarithmic(parameter) else value / parameter.typical


def from_scaled(parameter: Parameter, scaled: float) -> float:
    """The value of a scaled one, within the plausible range."""
    if parameter.relative:
        value = float(np.expm1(scaled * np.log1p(parameter.typical)))
    else:
        value = np.exp(scaled) if is_logarithmic(parameter) else scaled * parameter.typical
    return float(np.clip(value, parameter.low, parameter.high))


def unit_of(parameter: Parameter, value: float) -> float:
    """Derivative of the value by the scaled one, in the parameter's unit."""
    if parameter.relative:
        return float((1.0 + value) * np.log1p(parameter.typical))
    return value if is_logarithmic(parameter) else parameter.typical


def prior_precision(parameter: Parameter) -> float:
    """Prior precision of a scaled value: about zero for a size, about its start for a shape."""
    return parameter.spread**-2 if parameter.role == "size" else 1.0
