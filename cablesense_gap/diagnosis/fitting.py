"""Effects fitted to the recording with the simulator itself: damped Gauss-Newton.

Nuisance parameters enter linearly and are fitted along. The unexplained part is correlated from
row to row, so its weight is not that of white noise (`linear_fit.weight`). Held-out trials are
predicted with effects fitted to the other folds, linear about the fit to all (the one-step
estimate of Giordano et al., A Swiss Army infinitesimal jackknife, AISTATS 2019).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from cablesense_base import Array
from cablesense_gap.diagnosis.linear_fit import Products, fold_solutions, products, solve, weight
from cablesense_gap.diagnosis.problem import (
    Hypothesis,
    Problem,
    from_scaled,
    prior_precision,
    to_scaled,
    unit_of,
)
from cablesense_gap.diagnosis.selection import Proposal, Selection, own_columns
from cablesense_gap.simulator import Candidate, Term
from cablesense_sim.effects.effect import Parameter

MOST_STEPS = 8
"""Of Gauss-Newton; a fit that has not converged by then is no better than its rivals."""

_DERIVATIVE_STEP = 0.03
"""Scaled, for derivatives: far above the rounding of the simulator, small enough to be linear."""
_NEAR_DISTANCE = 0.25
"""Scaled distance to where derivatives still serve."""
_CONVERGED_STEP = 5e-3
"""Scaled step that is too small to continue: a two hundredth of a typical size."""
_CONVERGED_SHARE = 5e-3
"""Relative gain of the log posterior that is too small to continue a history-dependent fit."""
_CONVERGED_GAIN = 1.0
"""A gain of twice the log posterior that is too small to continue. It is absolute, because an
effect takes over from nuisance parameters by gains that are small compared with the whole."""
_FIRST_DAMPING = 1e-3
"""Of Levenberg and Marquardt, relative to the diagonal: first steps are almost Gauss-Newton's."""
_MOST_DAMPING = 30.0
"""Above which a step that gains nothing ends the fit: it is a thirtieth of Gauss-Newton's."""
_DAMPING_RISE = 30.0
"""Factor of the damping after a step that gains nothing: two such steps span its useful range."""
_DAMPING_FALL = 10.0
"""Divisor of the damping after a step that gains."""
_BOUND_PASSES = 3
"""Solutions of one step: values that leave their range stay at its end, the others continue."""


def refine(
    problem: Problem,
    parameters: Mapping[Term, Parameter],
    starts: Sequence[Sequence[float]],
    most_steps: int = MOST_STEPS,
    most_left: float = np.inf,
    start_at: tuple[Array, Array] | None = None,
) -> Hypothesis | None:
    """Fit values, from the best of several scaled starts.

    None if nothing there can be simulated, or if several starts all leave a mean square of more
    than `most_left`. For a single start, `start_at` may give the prediction and its columns.
    """
    return _Fit(problem, parameters).run(np.array(starts, float), most_steps, most_left, start_at)


def refit(
    problem: Problem,
    values: Mapping[Term, float],
    most_steps: int,
    start_at: tuple[Array, Array] | None = None,
) -> Hypothesis | None:
    """Fit values again, from `values`; None if these cannot be simulated.

    With no step allowed, they stay and only the nuisance parameters are fitted.
    """
    parameters = {term: problem.parameters[term] for term in values}
    start = [to_scaled(parameters[term], value) for term, value in values.items()]
    return refine(problem, parameters, [start], most_steps, start_at=start_at)


def refit_part(
    problem: Problem, hypothesis: Hypothesis, values: Mapping[Term, float], most_steps: int
) -> Hypothesis | None:
    """Fit some values of a hypothesis again, from its sensitivities to them.

    None if they cannot be simulated.
    """
    kept_indices = [k for k, term in enumerate(hypothesis.values) if term in values]
    predicted = problem.predict([values])[0]
    return refit(problem, values, most_steps, (predicted, hypothesis.columns[kept_indices]))


def joint_step(problem: Problem, hypothesis: Hypothesis) -> Hypothesis | None:
    """Values and nuisance parameters where their joint linear model is best.

    All else stays as it is. None if that promises too little. `refine` simulates a change of
    effects and takes nuisance parameters linearly. If an effect and a nuisance parameter are the
    same number, the two then differ by the effect's curvature, and `refine` stops after a short
    step.
    """
    parameters = {term: problem.parameters[term] for term in hypothesis.values}
    return _Fit(problem, parameters).joint_step(hypothesis)


class _Fit:
    def __init__(self, problem: Problem, parameters: Mapping[Term, Parameter]) -> None:
        self._problem = problem
        self._terms = tuple(parameters)
        self._parameters = tuple(parameters.values())
        self._nuisance_count = len(problem.nuisance_columns)
        self._prior = np.array([prior_precision(p) for p in self._parameters])
        self._precision = np.concatenate([np.ones(self._nuisance_count), self._prior])
        self._low = np.array([to_scaled(p, p.low) for p in self._parameters])
        self._high = np.array([to_scaled(p, p.high) for p in self._parameters])
        self._lasting = np.flatnonzero([not p.fades for p in self._parameters])
        self._shape = np.array([p.role == "shape" for p in self._parameters], dtype=bool)
        history = {c.effect for c in problem.simulator.candidates if c.history_dependent}
        effects = {term.effect for term in self._terms}
        self._slow = bool(effects & history)
        several = len(effects) > 2 and self._slow
        self._static = np.array([several and t.effect not in history for t in self._terms], bool)

    def run(
        self,
        starts: Array,
        most_steps: int,
        most_left: float,
        start_at: tuple[Array, Array] | None,
    ) -> Hypothesis | None:
        point, start_square = self._best(np.clip(starts, self._low, self._high))
        if start_square > most_left:
            return None
        self._expected = np.where(self._shape, point, 0.0)
        predicted, columns = start_at or self._linear(point)
        if not np.isfinite(predicted).all():
            return None
        damping = _FIRST_DAMPING
        mean_square = self._cost(point, predicted, None)[1]
        linear_at = point
        for _ in range(most_steps):
            step = self._step(point, predicted, columns, mean_square, damping)
            tried = np.clip(point + step, self._low, self._high)
            if np.abs(tried - point).max(initial=0.0) < _CONVERGED_STEP:
                break
            far = bool(np.abs(tried - linear_at).max() > _NEAR_DISTANCE)
            linear_model = self._linear(tried, columns) if far and self._slow else None
            ahead = self._predicted(tried) if linear_model is None else linear_model[0]
            before = self._cost(point, predicted, mean_square)
            after = self._cost(tried, ahead, mean_square)
            if not after[0] < before[0]:
                if damping > _MOST_DAMPING:
                    break
                damping *= _DAMPING_RISE
                continue
            point = tried
            predicted = ahead
            mean_square = after[1]
            damping /= _DAMPING_FALL
            if far:
                columns = (
                    self._linear(tried, columns)[1] if linear_model is None else linear_model[1]
                )
                linear_at = tried
            if before[0] - after[0] < (
                _CONVERGED_SHARE * before[0] if self._slow else _CONVERGED_GAIN
            ):
                break
        return self._hypothesis(point, predicted, columns, mean_square)

    def joint_step(self, hypothesis: Hypothesis) -> Hypothesis | None:
        """Take the step that is best for values and nuisance parameters together, or give None."""
        problem = self._problem
        nuisance_end = self._nuisance_count
        values = zip(self._parameters, hypothesis.values.values(), strict=True)
        point = np.array([to_scaled(parameter, value) for parameter, value in values])
        self._expected = np.where(self._shape, point, 0.0)
        predicted = hypothesis.without_nuisance
        all_columns = np.concatenate([problem.nuisance_columns, hypothesis.columns])
        data = self._products(predicted, all_columns)
        offset = self._offset(point)
        weight_ = weight(self._cost(point, predicted, None)[1], problem.floor)
        gram = data.gram.sum(0)
        moment = data.moment.sum(0)
        precision = self._precision
        solution = solve(gram, moment, precision, offset, weight_)
        t = slice(None, nuisance_end)
        step = solution.copy()
        step[t] -= solve(gram[t, t], moment[t], precision[t], offset[t], weight_)
        if step @ (weight_ * gram + np.diag(precision)) @ step < _CONVERGED_GAIN:
            return None
        ahead = np.clip(point + solution[nuisance_end:], self._low, self._high)
        nuisance = problem.nuisance_values_of(solution[t])
        return replace(hypothesis, values=self._assignment(ahead), nuisance=nuisance)

    def _best(self, starts: Array) -> tuple[Array, float]:
        """The start with the least residual, nuisance parameters fitted, and its mean square."""
        if len(starts) == 1:
            return starts[0], 0.0
        self._expected = starts[0]
        predicted = self._problem.predict([self._assignment(s) for s in starts])
        mean_squares = [self._cost(starts[0], prediction, None)[1] for prediction in predicted]
        best = int(np.argmin(mean_squares))
        return starts[best], mean_squares[best]

    def _predicted(self, point: Array) -> Array:
        return self._problem.predict([self._assignment(point)])[0]

    def _linear(self, point: Array, known: Array | None = None) -> tuple[Array, Array]:
        """The prediction (R, C) at one point, with its derivatives (K, R, C).

        Known derivatives by parameters that fade stay: they are many and matter in few rows.
        With several effects, derivatives by static effects are taken without the history-dependent
        ones, which are expensive to simulate.
        """
        steps = np.where(
            point + _DERIVATIVE_STEP <= self._high, _DERIVATIVE_STEP, -_DERIVATIVE_STEP
        )
        varied = np.arange(len(point)) if known is None else self._lasting
        columns = np.zeros((len(point), *self._problem.nominal.shape))
        if known is not None:
            columns[:] = known
        about: Array = np.empty(0)
        for static in (True, False) if self._static.any() else (False,):
            varied_part = varied[self._static[varied] == static]
            variants = [
                self._assignment(p) for p in (point, *(point + np.diag(steps)[varied_part]))
            ]
            if static:
                kept = {self._terms[k] for k in np.flatnonzero(self._static)}
                variants = [
                    {t: v for t, v in assignment.items() if t in kept} for assignment in variants
                ]
            about, *moved = self._problem.predict(variants)
            change = np.array(moved).reshape(len(varied_part), *about.shape) - about
            change[~np.isfinite(change).all(axis=(1, 2))] = 0.0
            columns[varied_part] = change / steps[varied_part].reshape(-1, 1, 1)
        return about, columns

    def _assignment(self, point: Array) -> dict[Term, float]:
        numbers = zip(self._terms, self._parameters, point, strict=True)
        return {term: from_scaled(parameter, value) for term, parameter, value in numbers}

    def _offset(self, point: Array) -> Array:
        return np.concatenate([np.zeros(self._nuisance_count), point - self._expected])

    def _step(
        self, point: Array, predicted: Array, columns: Array, mean_square: float, damping: float
    ) -> Array:
        all_columns = np.concatenate([self._problem.nuisance_columns, columns])
        data = self._products(predicted, all_columns)
        nuisance_end = self._nuisance_count
        weight_ = weight(mean_square, self._problem.floor)
        offset = self._offset(point)
        gram = data.gram.sum(0)
        moment = data.moment.sum(0)
        # damped by the part that nuisance parameters do not imitate: else an effect like one
        # hardly moves
        of_nuisance = weight_ * gram[:nuisance_end, :nuisance_end] + np.diag(
            self._precision[:nuisance_end]
        )
        imitated = np.linalg.solve(of_nuisance, gram[:nuisance_end, nuisance_end:])
        unimitated = np.zeros(len(gram))
        unimitated[nuisance_end:] = (
            gram[nuisance_end:, nuisance_end:]
            - weight_ * gram[nuisance_end:, :nuisance_end] @ imitated
        ).diagonal()
        unimitated[nuisance_end:] += self._prior / weight_
        damped = gram + damping * np.diag(unimitated)
        free = np.ones(len(gram), dtype=bool)
        for _ in range(_BOUND_PASSES):
            step = np.zeros(len(gram))
            free_indices = np.flatnonzero(free)
            step[free_indices] = solve(
                damped[np.ix_(free_indices, free_indices)],
                moment[free_indices],
                self._precision[free_indices],
                offset[free_indices],
                weight_,
            )
            ahead = point + step[nuisance_end:]
            below = (ahead < self._low) & (point <= self._low)
            stuck = below | ((ahead > self._high) & (point >= self._high))
            if not (stuck & free[nuisance_end:]).any():
                break
            free[nuisance_end:] &= ~stuck
        return step[nuisance_end:]

    def _products(self, predicted: Array, columns: Array) -> Products:
        """Products of columns (K, R, C), nuisance first, and the residual of a prediction."""
        problem = self._problem
        residual = self._residual(predicted)
        known = problem.nuisance_gram
        return products(columns, residual, problem.trial, problem.used, known)

    def _residual(self, predicted: Array) -> Array:
        return self._problem.readings - predicted - self._problem.nuisance_remainder

    def _cost(
        self, point: Array, prediction: Array, mean_square: float | None
    ) -> tuple[float, float]:
        """Negative log posterior, nuisance parameters fitted, and the mean square residual."""
        problem = self._problem
        if not np.isfinite(prediction).all():
            return np.inf, np.inf
        residual = self._residual(prediction)
        residual[~problem.used] = 0.0
        gram = problem.nuisance_gram.sum(0)
        count = residual[problem.used].size
        moment = np.tensordot(problem.nuisance_columns, residual, axes=2)
        square = float((residual**2).sum())
        zero_offset = np.zeros(len(moment))
        used = square / count if mean_square is None else mean_square
        for _ in range(2):
            weight_ = weight(used, problem.floor)
            nuisance = solve(gram, moment, np.ones(len(moment)), zero_offset, weight_)
            square_left = square - 2.0 * moment @ nuisance + nuisance @ gram @ nuisance
            if mean_square is None:
                used = float(square_left / count)
        prior = nuisance @ nuisance + self._prior @ (point - self._expected) ** 2
        return float(weight_ * square_left + prior), float(square_left / count)

    def _hypothesis(
        self, point: Array, predicted: Array, columns: Array, mean_square: float
    ) -> Hypothesis:
        problem = self._problem
        nuisance_end = self._nuisance_count
        all_columns = np.concatenate([problem.nuisance_columns, columns])
        data = self._products(predicted, all_columns)
        weight_ = weight(mean_square, problem.floor)
        off = self._offset(point)
        # at a bound the one-step refits of the folds may not move either
        inside = (point > self._low) & (point < self._high)
        free_indices = np.flatnonzero(np.concatenate([np.ones(nuisance_end, dtype=bool), inside]))
        part = data.columns(free_indices)
        precision = self._precision[free_indices]
        offset = off[free_indices]
        gram = part.gram.sum(0)
        moment = part.moment.sum(0)
        solution = solve(gram, moment, precision, offset, weight_)
        # of the values as they are: the effects' part of `solution` is a step that is not made
        t = slice(None, nuisance_end)
        nuisance = solve(gram[t, t], moment[t], precision[t], offset[t], weight_)
        all_columns = all_columns[free_indices]
        held_out_effects = predicted.copy()
        tolerated = np.zeros_like(predicted)
        folds = part.of_folds(problem.fold)
        without = fold_solutions(folds, nuisance_end, precision, offset, weight_)
        for k, coefficients in enumerate(without):
            rows = problem.fold[problem.trial] == k
            tolerated[rows] = np.tensordot(
                coefficients[:nuisance_end], all_columns[:nuisance_end, rows], axes=1
            )
            held_out_effects[rows] += np.tensordot(
                coefficients[nuisance_end:], all_columns[nuisance_end:, rows], axes=1
            )
        held_out = held_out_effects + tolerated + problem.nuisance_remainder
        covariance = np.zeros(2 * self._precision.shape)
        covariance[np.ix_(free_indices, free_indices)] = _covariance(
            part, solution, precision, weight_
        )
        # a value at its bound gets the deviation that it would have with all values free
        freed = solve(data.gram.sum(0), data.moment.sum(0), self._precision, off, weight_)
        spread = np.sqrt(_covariance(data, freed, self._precision, weight_).diagonal())
        spread[free_indices] = np.sqrt(covariance.diagonal()[free_indices])
        values = self._assignment(point)
        units = [unit_of(p, v) for p, v in zip(self._parameters, values.values(), strict=True)]
        return Hypothesis(
            effects=tuple(sorted({term.effect for term in self._terms})),
            values=values,
            deviations=dict(zip(self._terms, 1.96 * spread[nuisance_end:] * units, strict=True)),
            nuisance=problem.nuisance_values_of(nuisance),
            prediction=predicted
            + np.tensordot(nuisance, problem.nuisance_columns, axes=1)
            + problem.nuisance_remainder,
            without_nuisance=predicted,
            columns=columns,
            covariance=covariance[nuisance_end:, nuisance_end:],
            held_out=held_out,
            held_out_effects=held_out_effects,
            squares=problem.squares_by_trial(held_out)[0],
            count=data.count,
            sizes=int((~self._shape & columns.any(axis=(1, 2))).sum()),
            nuisance_chi2=float((nuisance**2).sum()),
            nuisance_count=int(problem.acting_directions.sum()),
        )


def _covariance(part: Products, found: Array, precision: Array, weight_: float) -> Array:
    """Covariance (K, K) that allows for residuals that are correlated within a trial.

    The sandwich of White, generalised to clusters (Liang and Zeger, Biometrika 1986); the priors
    count as one more, or an effect like a nuisance parameter would be known better than the
    nuisance parameter is.
    """
    bread = np.linalg.inv(weight_ * part.gram.sum(0) + np.diag(precision))
    scores = weight_ * (part.moment - part.gram @ found)
    return np.asarray(bread @ (scores.T @ scores + np.diag(precision)) @ bread)


_SCALES = (0.3, 1.0, 3.0)
"""In typical sizes: where a fit starts if linear columns say little about the size."""
_STEPS_OF_PART = 3
"""Of Gauss-Newton: a part of a hypothesis is near its best values already."""
_LEAST_DIVISOR = 0.3
"""Scaled size by which a shape's change is divided at least: it says nothing about a shape where
the effect hardly exists."""
_LEAST_START = 0.1
"""Scaled size at which a history-dependent effect starts at least, before `_SCALES`."""


def fit(problem: Problem, proposal: Proposal) -> list[Hypothesis]:
    """Fit the additions; gives the hypothesis with them, and one without locations of little use.

    Nothing if the simulator cannot follow. A history-dependent effect starts with smaller and
    larger sizes too, and with every combination of the shapes that its columns do not distinguish.
    """
    ranges = problem.parameters
    known = proposal.beside.values
    start, impossible = _start(problem, proposal)
    before = [to_scaled(ranges[term], value) for term, value in known.items()]
    names = {term.effect for term in (*known, *start)}
    slow = [c for c in problem.simulator.candidates if c.history_dependent and c.effect in names]
    starts = [[*before, *start.values()]]
    if slow and not known:
        starts = [list(each.values()) for each in _other_starts(problem, start, slow)]
    if impossible:
        # far from its linear columns, the sum of a size's and a shape's change means nothing
        for scale in _SCALES:
            sizes = {t: scale for t in impossible if ranges[t].role == "size"}
            starts.append([*before, *(start | impossible | sizes).values()])
    fitted = refine(
        problem,
        {term: ranges[term] for term in (*known, *start)},
        starts,
        MOST_STEPS // 2 if slow else MOST_STEPS,  # the best of many starts is near already
        proposal.most_left if slow else np.inf,
    )
    return [] if fitted is None else _with_fewer_locations(problem, fitted, known)


def refitted(problem: Problem, hypothesis: Hypothesis) -> list[Hypothesis]:
    """A hypothesis fitted until it converges, and without locations that earn too little."""
    fitted = refit(problem, hypothesis.values, 2 * MOST_STEPS)
    return [] if fitted is None else _with_fewer_locations(problem, fitted)


def _with_fewer_locations(
    problem: Problem, fitted: Hypothesis, known: Collection[Term] = ()
) -> list[Hypothesis]:
    """The hypothesis, and one with the locations alone that are worth their penalty.

    Not the latter if it has the terms `known`, of a hypothesis that was fitted.
    """
    nothing, locations = own_columns(problem, fitted)
    kept = {locations[k].terms[0][:2] for k in Selection(problem, nothing, locations).kept()}
    values = {term: v for term, v in fitted.values.items() if not kept or term[:2] in kept}
    smaller = None
    if len(values) < len(fitted.values) and values.keys() != set(known):
        smaller = refit_part(problem, fitted, values, _STEPS_OF_PART)
    return [fitted, smaller] if smaller else [fitted]


def without(problem: Problem, effects: Sequence[str], hypothesis: Hypothesis) -> Hypothesis | None:
    """A hypothesis without some of its effects, fitted again; None if it cannot be simulated."""
    kept = {t: v for t, v in hypothesis.values.items() if t.effect not in effects}
    return refit_part(problem, hypothesis, kept, _STEPS_OF_PART)


def _start(problem: Problem, proposal: Proposal) -> tuple[dict[Term, float], dict[Term, float]]:
    """Scaled values to start at, and others for the places with a size out of its range."""
    ranges = problem.parameters
    start: dict[Term, float] = {}
    impossible: dict[Term, float] = {}
    coefficients = iter(proposal.coefficients)
    for effect in proposal.added:
        change = {term: next(coefficients) for term in effect.varied}
        sizes = [term for term in effect.terms if ranges[term].role == "size"]
        first = max(abs(change[sizes[0]]), _LEAST_DIVISOR)
        for term, start_value in zip(effect.terms, effect.start, strict=True):
            # the column of a shape is its effect at a size of one
            added = change.get(term, 0.0)
            start[term] = added if ranges[term].role == "size" else start_value + added / first
        for term in sizes:
            low, high = (to_scaled(ranges[term], v) for v in (ranges[term].low, ranges[term].high))
            if not low <= change[term] <= high:
                impossible |= dict(zip(effect.terms, effect.start, strict=True))
    return start, impossible


def _other_starts(
    problem: Problem, start: Mapping[Term, float], slow: Sequence[Candidate]
) -> Iterator[dict[Term, float]]:
    """The start with other sizes of the effects `slow`, and with every combination of shapes."""
    ranges = problem.parameters
    slow_effects = {c.effect for c in slow}
    shapes: list[dict[tuple[str, str], float]] = []
    for candidate in slow:
        free = [p for p in candidate.parameters if p.role == "shape" and p.trials]
        names = [(candidate.effect, p.name) for p in free]
        scaled = [[to_scaled(p, value) for value in p.trials] for p in free]
        shapes += [dict(zip(names, values, strict=True)) for values in product(*scaled)]
    for scale, shape in product(_SCALES, shapes or [{}]):
        yield {
            term: value
            if term.effect not in slow_effects
            else max(abs(value), _LEAST_START) * scale
            if ranges[term].role == "size"
            else shape.get((term.effect, term.parameter), value)
            for term, value in start.items()
        }
