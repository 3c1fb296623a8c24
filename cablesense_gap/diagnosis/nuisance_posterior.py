"""What a recording says about a machine's nuisance parameters, beside its effects.

Fits move nuisance parameters in the directions that readings show (`problem.nuisance_directions`).
Whoever continues with the machine wants all of them with their covariance. Here they are linear
about the hypothesis, with normal priors: the posterior is that of a Kalman update with the
recording.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cablesense_base import Array
from cablesense_gap.diagnosis.linear_fit import weight
from cablesense_gap.diagnosis.problem import (
    Hypothesis,
    Problem,
    from_scaled,
    prior_precision,
    to_scaled,
)
from cablesense_gap.simulator import Term, small_changes

_STEP_OF_STD = 0.1
"""For derivatives, of a standard deviation."""
_MOST_STEPS = 4
"""Gauss-Newton steps: the hypothesis is near the best values already."""
_SMALL_STEP = 0.1
"""A step that is too small to continue, in deviations of the posterior."""


@dataclass(frozen=True)
class NuisancePosterior:
    """Nuisance parameters after a recording.

    Attributes:
        terms: the K nuisance parameters that were fitted.
        mean: (K,) in their units.
        covariance: (K, K) of them; effects and all other nuisance parameters may be anything
            beside them.
    """

    terms: tuple[Term, ...]
    mean: Array
    covariance: Array


def nuisance_posterior(problem: Problem, hypothesis: Hypothesis) -> NuisancePosterior:
    """Nuisance parameters beside a hypothesis's effects.

    Gauss-Newton's method from the hypothesis: what a recording shows best, it shows to a
    thousandth of a nuisance parameter, and there no column is linear. Columns of nuisance
    parameters are without friction and creep, which are expensive to simulate; those of effects
    are the hypothesis's. A residual that the hypothesis leaves counts as in all fits: it makes
    readings count less.
    """
    terms = problem.nuisance_terms
    if not terms:
        return NuisancePosterior((), np.zeros(0), np.zeros((0, 0)))
    fit = _Fit(problem, hypothesis)
    std = problem.nuisance_std
    scaled = np.array([hypothesis.nuisance.get(term, 0.0) for term in terms]) / std
    effects = (to_scaled(fit.parameters[t], v) for t, v in hypothesis.values.items())
    point = np.concatenate([scaled, np.fromiter(effects, float)])
    residual = problem.readings - hypothesis.prediction
    covariance, step = fit.step(point, residual)
    cost = np.inf
    for _ in range(_MOST_STEPS):
        ahead = point + step
        residual = fit.residual(ahead)
        after = fit.cost(ahead, residual)
        if not after < cost:
            break
        point = ahead
        cost = after
        covariance, step = fit.step(point, residual)
        if (step**2 < _SMALL_STEP**2 * covariance.diagonal()).all():
            break
    k = slice(None, len(terms))
    return NuisancePosterior(terms, std * point[k], covariance[k, k] * np.outer(std, std))


class _Fit:
    """Nuisance parameters in standard deviations and scaled values of effects, one vector (K,)."""

    def __init__(self, problem: Problem, hypothesis: Hypothesis) -> None:
        self._problem = problem
        self._columns = hypothesis.columns
        self.parameters = {term: problem.parameters[term] for term in hypothesis.values}
        values = hypothesis.values.items()
        expected = [
            to_scaled(self.parameters[t], v) if self.parameters[t].role == "shape" else 0.0
            for t, v in values
        ]
        of_effects = [prior_precision(parameter) for parameter in self.parameters.values()]
        nothing = np.zeros(len(problem.nuisance_terms))
        self._expected = np.concatenate([nothing, expected])
        self._precision = np.concatenate([nothing + 1.0, of_effects])
        self._weight = weight(hypothesis.held_out_rmse**2, problem.floor)

    def _assignment(self, point: Array) -> dict[Term, float]:
        count = len(self._problem.nuisance_terms)
        nuisance = (self._problem.nuisance_std * point[:count]).tolist()
        assignment = dict(zip(self._problem.nuisance_terms, nuisance, strict=True))
        for (term, parameter), scaled in zip(
            self.parameters.items(), point[count:].tolist(), strict=True
        ):
            assignment[term] = from_scaled(parameter, scaled)
        return assignment

    def residual(self, point: Array) -> Array:
        """Readings (R, C) less what the simulator predicts at a point (K,)."""
        predicted = self._problem.simulator.predict([self._assignment(point)])[0]
        return np.asarray(self._problem.readings - predicted)

    def cost(self, point: Array, residual: Array) -> float:
        """Twice the negative log posterior."""
        squares = float((residual[self._problem.used] ** 2).sum())
        off = point - self._expected
        return self._weight * squares + float(off @ (self._precision * off))

    def step(self, point: Array, residual: Array) -> tuple[Array, Array]:
        """Covariance (K, K) about a point, and the step (K,) to where the linear model is best."""
        problem = self._problem
        history = {c.effect for c in problem.simulator.candidates if c.history_dependent}
        base = {t: v for t, v in self._assignment(point).items() if t.effect not in history}
        steps = dict(zip(problem.nuisance_terms, problem.nuisance_std.tolist(), strict=True))
        variants = [{**base, t: base[t] + _STEP_OF_STD * std} for t, std in steps.items()]
        columns = small_changes(problem.simulator, base, variants) / _STEP_OF_STD
        columns[~np.isfinite(columns).all(axis=(1, 2))] = 0.0
        all_columns = np.concatenate([columns, self._columns])[:, problem.used]
        all_columns = all_columns.reshape(len(all_columns), -1)
        system = self._weight * all_columns @ all_columns.T + np.diag(self._precision)
        covariance = np.linalg.inv(system)
        pull = self._weight * all_columns @ residual[problem.used].ravel()
        pull -= self._precision * (point - self._expected)
        return covariance, covariance @ pull
