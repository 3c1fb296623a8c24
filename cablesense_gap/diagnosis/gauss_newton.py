"""Effects fitted to the recording with the simulator itself: damped Gauss-Newton.

Tolerances enter linearly and are fitted along. What no candidate explains is correlated from row
to row, so the fit gives each number the weight that such a residual deserves, not that of white
noise (`evidence.weight`); held-out trials are predicted by the fit to the other folds, linear
about the one to all (the one-step estimate of Giordano et al., A Swiss Army infinitesimal
jackknife, AISTATS 2019).

A fit that goes on from numbers that are known already.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_base.arrays import Array
from cablesense_gap.diagnosis.evidence import Products, fold_solutions, products, solve, weight
from cablesense_gap.diagnosis.problem import (
    Course,
    Hypothesis,
    from_scaled,
    is_logarithmic,
    prior_precision,
    to_scaled,
)
from cablesense_gap.simulator import Candidate, Term
from cablesense_sim.effects.effect import Parameter

_STEP = 0.03
_CLOSE = 5e-3
_WORTH = 5e-3
_MOST_DAMPING = 0.5


@dataclass(frozen=True)
class _Linear:
    """The recording's prediction about one point, with its derivatives."""

    prediction: Array
    columns: Array


def refine(
    course: Course,
    parameters: Mapping[Term, Parameter],
    starts: Sequence[Sequence[float]],
    most_steps: int = 8,
    most_left: float = np.inf,
) -> Hypothesis | None:
    """The most probable numbers from the best of some scaled starts on.

    None where nothing there can be simulated, or where several starts all leave a mean square of
    more than `most_left`.
    """
    return _Refining(course, parameters).run(np.array(starts, float), most_steps, most_left)


class _Refining:
    def __init__(self, course: Course, parameters: Mapping[Term, Parameter]) -> None:
        self._course = course
        self._terms, self._parameters = tuple(parameters), tuple(parameters.values())
        tolerances = len(course.tolerance_columns)
        self._prior = np.array([prior_precision(p) for p in self._parameters])
        self._precision = np.concatenate([np.ones(tolerances), self._prior])
        self._low = np.array([_scaled_bound(p, p.low) for p in self._parameters])
        self._high = np.array([_scaled_bound(p, p.high) for p in self._parameters])

    def run(self, starts: Array, most_steps: int, most_left: float) -> Hypothesis | None:
        point, left = self._best(np.clip(starts, self._low, self._high))
        if left > most_left:
            return None
        shape = np.array([p.role == "shape" for p in self._parameters], dtype=bool)
        self._expected = np.where(shape, point, 0.0)
        self._expected_before = np.array(
            [to_scaled(p, p.default) if p.role == "shape" else 0.0 for p in self._parameters]
        )
        linear = self._linear(point)
        if not np.isfinite(linear.prediction).all():
            return None
        damping, cost = 1e-3, self._cost(point, linear.prediction, None)
        mean_square = cost[1]
        for _ in range(most_steps):
            step = self._step(point, linear, mean_square, damping)
            tried = np.clip(point + step, self._low, self._high)
            if np.abs(tried - point).max(initial=0.0) < _CLOSE:
                break
            ahead = self._linear(tried)
            before = self._cost(point, linear.prediction, mean_square)
            after = self._cost(tried, ahead.prediction, mean_square)
            if not after[0] < before[0]:
                if damping > _MOST_DAMPING:
                    break
                damping *= 30.0
                continue
            gained = (before[0] - after[0]) / before[0]
            point, linear, mean_square = tried, ahead, after[1]
            damping = max(damping / 10.0, 1e-6)
            if gained < _WORTH:
                break
        return self._hypothesis(point, linear, mean_square)

    def _best(self, starts: Array) -> tuple[Array, float]:
        """The start that leaves least, with the tolerances at their best, and that mean square."""
        if len(starts) == 1:
            return starts[0], 0.0
        self._expected = starts[0]
        predicted = self._course.simulator.predict([self._assignment(s) for s in starts])
        left = [self._cost(starts[0], prediction, None)[1] for prediction in predicted]
        best = int(np.argmin(left))
        return starts[best], left[best]

    def _linear(self, point: Array) -> _Linear:
        moved = []
        steps = np.where(point + _STEP <= self._high, _STEP, -_STEP)
        for k, step in enumerate(steps):
            moved.append(point.copy())
            moved[-1][k] += step
        variants = [self._assignment(p) for p in (point, *moved)]
        predicted = self._course.simulator.predict(variants)
        columns = (predicted[1:] - predicted[0]) / steps.reshape(-1, 1, 1)
        usable = np.isfinite(columns).all(axis=(1, 2))
        columns[~usable] = 0.0
        return _Linear(predicted[0], columns)

    def _assignment(self, point: Array) -> dict[Term, float]:
        return {
            term: from_scaled(parameter, value)
            for term, parameter, value in zip(self._terms, self._parameters, point, strict=True)
        }

    def _step(self, point: Array, linear: _Linear, mean_square: float, damping: float) -> Array:
        data = self._products(linear)
        weight_ = weight(mean_square, self._course.floor)
        tolerances = len(self._precision) - len(point)
        offset = np.concatenate([np.zeros(tolerances), point - self._expected])
        gram = data.gram.sum(0)
        own = np.where(np.arange(len(gram)) < tolerances, 0.0, gram.diagonal())
        free = np.ones(len(self._precision), dtype=bool)
        step = np.zeros(len(self._precision))
        for _ in range(3):  # numbers that leave their range stay at its end, the others go on
            damped = gram + damping * np.diag(own)
            step = np.zeros(len(self._precision))
            at = np.flatnonzero(free)
            step[at] = solve(
                damped[np.ix_(at, at)],
                data.moment.sum(0)[at],
                self._precision[at],
                offset[at],
                weight_,
            )
            ahead = point + step[tolerances:]
            stuck = ((ahead < self._low) & (point <= self._low)) | (
                (ahead > self._high) & (point >= self._high)
            )
            if not (stuck & free[tolerances:]).any():
                break
            free[tolerances:] &= ~stuck
        return step[tolerances:]

    def _products(self, linear: _Linear) -> Products:
        course = self._course
        columns = np.concatenate([course.tolerance_columns, linear.columns])
        return products(columns, course.readings - linear.prediction, course.trial, course.used)

    def _cost(
        self, point: Array, prediction: Array, mean_square: float | None
    ) -> tuple[float, float]:
        """Negative log posterior with tolerances at their best, and the mean square left."""
        course = self._course
        if not np.isfinite(prediction).all():
            return np.inf, np.inf
        data = products(
            course.tolerance_columns, course.readings - prediction, course.trial, course.used
        )
        gram, moment = data.gram.sum(0), data.moment.sum(0)
        none = np.zeros(len(moment))
        used = data.mean_square if mean_square is None else mean_square
        for _ in range(2):
            weight_ = weight(used, course.floor)
            found = solve(gram, moment, np.ones(len(moment)), none, weight_)
            left = data.square.sum() - 2.0 * moment @ found + found @ gram @ found
            if mean_square is None:
                used = float(left / data.count.sum())
        prior = found @ found + self._prior @ (point - self._expected) ** 2
        return float(weight_ * left + prior), float(left / data.count.sum())

    def _hypothesis(self, point: Array, linear: _Linear, mean_square: float) -> Hypothesis:
        course = self._course
        data = self._products(linear)
        weight_ = weight(mean_square, course.floor)
        tolerances = len(self._precision) - len(point)
        # at a bound the one-step refits of the folds may not move either
        inside = (point > self._low) & (point < self._high)
        at = np.flatnonzero(np.concatenate([np.ones(tolerances, dtype=bool), inside]))
        offset = np.concatenate([np.zeros(tolerances), point - self._expected])[at]
        part, precision = data.columns(at), self._precision[at]
        gram, moment = part.gram.sum(0), part.moment.sum(0)
        found = solve(gram, moment, precision, offset, weight_)
        without = fold_solutions(part, precision, offset, weight_, course.fold)
        held_out = _held_out(course, linear, without, at)
        spread = np.zeros(len(self._precision))
        spread[at] = _spread(part.gram, part.moment, found, precision, weight_)
        values = self._assignment(point)
        return Hypothesis(
            effects=tuple(sorted({term.effect for term in self._terms})),
            values=values,
            deviations={
                term: 1.96 * spread[tolerances + k] * _unit(parameter, values[term])
                for k, (term, parameter) in enumerate(
                    zip(self._terms, self._parameters, strict=True)
                )
            },
            tolerances=dict(
                zip(course.tolerance_terms, found[:tolerances] * course.tolerance_std, strict=True)
            ),
            prediction=linear.prediction
            + np.tensordot(found[:tolerances], course.tolerance_columns, axes=1),
            without_tolerances=linear.prediction,
            columns=linear.columns,
            held_out=held_out,
            squares=_squares(course, course.readings - held_out),
            count=data.count,
            sizes=sum(p.role == "size" for p in self._parameters),
            strain=float((found[:tolerances] ** 2).sum()),
            strangeness=float(self._prior @ (point - self._expected_before) ** 2),
        )


def _held_out(course: Course, linear: _Linear, without: Array, at: NDArray[np.int64]) -> Array:
    """(R, C) prediction of each trial by the fit without its fold."""
    columns = np.concatenate([course.tolerance_columns, linear.columns])[at]
    prediction = linear.prediction.copy()
    for k, found in enumerate(without):
        rows = course.fold[course.trial] == k
        prediction[rows] += np.tensordot(found, columns[:, rows], axes=1)
    return prediction


def _squares(course: Course, residual: Array) -> Array:
    """(T,) sum of squares of a residual (R, C) in each trial, over the rows that count."""
    of_row = (residual**2).sum(-1) * course.used
    return np.bincount(course.trial, of_row, minlength=len(course.fold)).astype(float)


def _spread(gram: Array, moment: Array, found: Array, precision: Array, weight_: float) -> Array:
    """Standard deviations (K,) that allow for residuals that hang together within a trial.

    The sandwich of White, generalised to clusters (Liang and Zeger, Biometrika 1986); the priors
    count as one more, or what looks like a tolerance would be known better than the tolerance is.
    """
    bread = np.linalg.inv(weight_ * gram.sum(0) + np.diag(precision))
    scores = weight_ * (moment - gram @ found)
    return np.sqrt(np.diagonal(bread @ (scores.T @ scores + np.diag(precision)) @ bread))


def _scaled_bound(parameter: Parameter, value: float) -> float:
    return float(np.log(value)) if is_logarithmic(parameter) else value / parameter.typical


def _unit(parameter: Parameter, value: float) -> float:
    return value if is_logarithmic(parameter) else parameter.typical


def refit(course: Course, values: Mapping[Term, float], most_steps: int) -> Hypothesis | None:
    """The most probable numbers from `values` on; None where these cannot be simulated.

    With no step allowed they stay, and only the tolerances are fitted.
    """
    candidates = {c.effect: c for c in course.simulator.candidates}
    parameters = {term: parameter_of(candidates, term) for term in values}
    start = [to_scaled(parameters[term], value) for term, value in values.items()]
    return refine(course, parameters, [start], most_steps)


def parameter_of(candidates: Mapping[str, Candidate], term: Term) -> Parameter:
    """What a number is, and within which range."""
    return next(p for p in candidates[term.effect].parameters if p.name == term.parameter)
