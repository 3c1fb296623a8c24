"""Tolerances, linear about where they are: the tensions of a stiff arm call for that.

Every fit takes them linearly (`fitting`). Here their columns are taken about the tolerances of a
fit, and again until the simulator agrees with the linear prediction. Columns leave out the
history-dependent effects; the prediction that they are added to has them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cablesense_base import Array
from cablesense_gap.diagnosis.fitting import refine, refit
from cablesense_gap.diagnosis.problem import RESOLUTION, Explanation, Problem

_STEP_OF_STD = 0.1
"""For derivatives by tolerances."""
_MOST_REPEATED, _FAR_OFF = 4, 5.0
"""Times that tolerances are made linear anew, and the standard deviations from which on one of
them imitates an effect and is no place to be linear about."""


def with_fitted_tolerances(problem: Problem) -> Problem:
    """The problem with tolerances linear about those that fit best to it, without an effect.

    The tensions of a stiff arm are far from linear in them. The same problem where that is no
    more than what residuals can show.
    """
    for _ in range(_MOST_REPEATED):
        none = refine(problem, {}, [[]])
        assert none is not None
        std = dict(zip(problem.tolerance_terms, problem.tolerance_std, strict=True))
        far_off = any(abs(value) > _FAR_OFF * std[term] for term, value in none.tolerances.items())
        if far_off or _is_consistent(problem, none):
            break
        problem = _with_tolerances_of(problem, none) or problem
    return problem


def final_refinement(
    problem: Problem, explanation: Explanation
) -> tuple[Explanation, tuple[Array, Array]]:
    """Fit the same effects with tolerances that are linear about the explanation.

    The search takes tolerances linear about a mechanism without effects, which is near enough to
    choose by. Gives the columns (K, R, C) of the tolerances and their rest (R, C) too.
    """
    best, used = explanation, problem
    for _ in range(_MOST_REPEATED if explanation.values else 0):
        if _is_consistent(problem, best):
            break
        about = _with_tolerances_of(problem, best)
        start_at = best.without_tolerances, best.columns
        fitted = None if about is None else refit(about, best.values, 3, start_at)
        if about is None or fitted is None or problem.cost_of(fitted) > problem.cost_of(best):
            break
        best, used = fitted, about
    return best, (used.tolerance_columns, used.tolerance_rest)


def _is_consistent(problem: Problem, explanation: Explanation) -> bool:
    """Whether the simulator predicts each trial the same with the fitted, linear tolerances."""
    predicted = problem.simulator.predict([{**explanation.values, **explanation.tolerances}])[0]
    off = np.where(problem.used[:, None], predicted - explanation.prediction, 0.0)
    squares = np.bincount(problem.trial, (off**2).mean(1), len(problem.fold))
    used = np.bincount(problem.trial, problem.used, len(problem.fold))
    limit = (RESOLUTION * problem.floor) ** 2
    return bool((squares <= limit * used).all())


def _with_tolerances_of(problem: Problem, explanation: Explanation) -> Problem | None:
    """The problem with tolerances linear about the explanation's; None if that is impossible."""
    if not problem.tolerance_terms:
        return None
    std = dict(zip(problem.tolerance_terms, problem.tolerance_std.tolist(), strict=True))
    at = dict.fromkeys(std, 0.0) | dict(explanation.tolerances)
    # towards zero, so that no tolerance leaves its range
    steps = {term: -_STEP_OF_STD * np.copysign(std[term], value) for term, value in at.items()}
    predict, candidates = problem.simulator.predict, problem.simulator.candidates
    # a hundred simulations with friction or creep would take minutes, to change the columns little
    history = {c.effect for c in candidates if c.history_dependent}
    lasting = {t: value for t, value in explanation.values.items() if t.effect not in history}
    base = {**lasting, **at}
    variants = [base, *({**base, term: at[term] + step} for term, step in steps.items())]
    there, *moved = predict(variants)
    scaled = np.array([step / std[term] for term, step in steps.items()])
    columns = (np.array(moved) - there) / scaled[:, None, None]
    if lasting != explanation.values:
        there = predict([{**explanation.values, **at}])[0]
    fitted = np.array([value / std[term] for term, value in at.items()])
    rest = there - explanation.without_tolerances - np.tensordot(fitted, columns, axes=1)
    if not np.isfinite(columns).all() or not np.isfinite(rest).all():
        return None
    return replace(problem, tolerance_columns=columns, tolerance_rest=rest)
