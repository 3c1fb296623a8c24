"""Nuisance parameters, linear about where they are: the tensions of a stiff arm call for that.

Every fit takes them linearly (`fitting`). Here their columns are taken about the nuisance
parameters of a fit, and again until the simulator agrees with the linear prediction. With friction
of cables a nuisance parameter changes other tensions than without, so columns are taken with the
fitted effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cablesense_base import Array
from cablesense_gap.diagnosis.fitting import joint_step, refine, refit
from cablesense_gap.diagnosis.problem import (
    RESOLUTION,
    Hypothesis,
    Problem,
    from_scaled,
    to_scaled,
)
from cablesense_gap.simulator import Assignment, Term, small_changes

_STEP_OF_STD = 0.1
"""For derivatives, of a nuisance parameter's standard deviation."""
_STEP_OF_EFFECT = 0.03
"""For derivatives, of an effect's typical size."""
_STEP_OF_FLOOR = 0.2
"""Of the floor (RMS): no step of a derivative changes readings by more. On a stiff arm a larger
one takes cables slack, and derivatives across such kinks lead fits astray. The rounding of
equilibria is a thousandth of that."""
_MOST_REPEATED = 6
"""Times that nuisance parameters are made linear anew: those that still move then do not
converge."""
_SAME_OF_STD = 0.01
"""Standard deviations from where a nuisance parameter is linear within which it is there."""
_MOST_OFF = 3.0
"""Standard deviations up to which nuisance parameters are a place to be linear about."""
_STEPS_ANEW = 3
"""Of Gauss-Newton with nuisance parameters linear anew: the hypothesis is near its best values
already."""
_LEAST_CHANGE = 1e-12
"""RMS change below which a column counts as zero, in the unit of the channels: rounding."""


def with_fitted_nuisance(problem: Problem) -> Problem:
    """The problem with nuisance parameters linear about those that fit best without an effect.

    The tensions of a stiff arm are far from linear in them. The columns stay as they are where
    that is no more than residuals can show.
    """
    without_effects = refine(problem, {}, [[]])
    assert without_effects is not None
    return final_refinement(problem, without_effects)[1]


def final_refinement(problem: Problem, hypothesis: Hypothesis) -> tuple[Hypothesis, Problem]:
    """Fit the same effects with nuisance parameters that are linear about the hypothesis.

    The search takes nuisance parameters linear about a mechanism without effects, which is near
    enough to choose by. Nuisance parameters that are farther off than usual may carry a part of an
    effect. Effects and nuisance parameters then step together, and the columns of both are taken
    anew, until nuisance parameters are usual or nothing is gained. The best of these fits counts:
    a step may lead too far. Gives the problem with these nuisance parameters too.
    """
    best = hypothesis, problem
    latest = best
    done = (_has_usual_nuisance(hypothesis) or not hypothesis.values) and _is_consistent(
        problem, hypothesis
    )
    for _ in range(0 if done else _MOST_REPEATED):
        before, used = latest
        linear = _linear_about(used, before)
        if linear is None:
            break
        about, start_at = linear
        unmoved, fitted = (refit(about, before.values, n, start_at) for n in (0, _STEPS_ANEW))
        assert unmoved is not None
        assert fitted is not None
        if problem.cost_of(fitted) < problem.cost_of(best[0]):
            best = fitted, about
        settled = _has_usual_nuisance(fitted) or joint_step(about, unmoved) is None
        if settled and (_is_linear_there(about, fitted) or _is_consistent(about, fitted)):
            break
        latest = joint_step(about, fitted) or fitted, about
    if best[1] is problem:
        return best
    alone = problem.predict([best[0].values])[0]
    return replace(best[0], without_nuisance=alone), best[1]


def _linearisation_point(problem: Problem, nuisance: Assignment) -> Array:
    """(K,) nuisance parameters to be linear about."""
    most = _MOST_OFF * problem.nuisance_std
    off = np.array([nuisance.get(term, 0.0) for term in problem.nuisance_terms])
    return np.clip(off, -most, most)


def _is_linear_there(problem: Problem, hypothesis: Hypothesis) -> bool:
    """Whether nuisance parameters are linear about these already, so that nothing would change."""
    off = _linearisation_point(problem, hypothesis.nuisance) - _linearisation_point(
        problem, problem.nuisance_at
    )
    return bool((np.abs(off) <= _SAME_OF_STD * problem.nuisance_std).all())


def _has_usual_nuisance(hypothesis: Hypothesis) -> bool:
    return hypothesis.nuisance_chi2 <= hypothesis.nuisance_count


def _is_consistent(problem: Problem, hypothesis: Hypothesis) -> bool:
    """Whether the simulator predicts each trial as the linear nuisance parameters do."""
    predicted = problem.simulator.predict([{**hypothesis.values, **hypothesis.nuisance}])[0]
    off = np.where(problem.used[:, None], predicted - hypothesis.prediction, 0.0)
    squares = np.bincount(problem.trial, (off**2).mean(1), len(problem.fold))
    used = np.bincount(problem.trial, problem.used, len(problem.fold))
    limit = (RESOLUTION * problem.floor) ** 2
    return bool((squares <= limit * used).all())


def _linear_about(
    problem: Problem, hypothesis: Hypothesis
) -> tuple[Problem, tuple[Array, Array]] | None:
    """The problem with nuisance parameters linear about a hypothesis with its nuisance parameters.

    Gives its prediction (R, C) and the columns (K, R, C) of its effects there too: an effect that
    changes readings as a nuisance parameter does must have the same column. None if the simulator
    cannot follow.
    """
    if not problem.nuisance_terms:
        return None
    std = problem.nuisance_std
    terms = problem.nuisance_terms
    off = _linearisation_point(problem, hypothesis.nuisance)
    nuisance_at = dict(zip(terms, off.tolist(), strict=True))
    change = np.sqrt((problem.nuisance_columns[:, problem.used] ** 2).mean(axis=(1, 2)))
    size = 1.0 / np.maximum(1.0 / _STEP_OF_STD, change / (_STEP_OF_FLOOR * problem.floor))
    # towards zero, so that no nuisance parameter leaves its range
    steps = -np.copysign(size, problem.coefficients_of(nuisance_at))
    moved = off + steps[:, None] * (problem.nuisance_mix.T * std)
    # numbers that fade matter in few rows, and their columns stay
    varied = [t for t in hypothesis.values if not problem.parameters[t].fades]
    base = {**hypothesis.values, **nuisance_at}
    scaled, values = _effect_steps(problem, hypothesis, varied)
    prediction = problem.simulator.predict([base])[0]
    variants = [{**base, **dict(zip(terms, row, strict=True))} for row in moved.tolist()]
    variants += [{**base, t: v} for t, v in zip(varied, values, strict=True)]
    changes = small_changes(problem.simulator, base, variants)
    columns = changes[: len(steps)] / steps[:, None, None]
    effects = hypothesis.columns.copy()
    varied_indices = [list(hypothesis.values).index(term) for term in varied]
    effects[varied_indices] = changes[len(steps) :] / scaled[:, None, None]
    linearised = with_nuisance_at(problem, nuisance_at, columns)
    arrays = prediction, columns, effects, linearised.nuisance_change
    if not all(np.isfinite(array).all() for array in arrays):
        return None
    return linearised, (prediction - linearised.nuisance_change, effects)


def with_nuisance_at(problem: Problem, at: Assignment, columns: Array) -> Problem:
    """The problem with nuisance parameters linear about `at`, with the columns (J, R, C) there."""
    change = problem.simulator.predict([at])[0] - problem.nominal
    fitted = problem.coefficients_of(at)
    return replace(
        problem,
        nuisance_columns=columns,
        nuisance_remainder=change - np.tensordot(fitted, columns, axes=1),
        nuisance_at=at,
        nuisance_change=change,
    )


def _effect_steps(
    problem: Problem, hypothesis: Hypothesis, varied: Sequence[Term]
) -> tuple[Array, list[float]]:
    """Scaled steps (K,) that change readings as nuisance parameters do, and the values there."""
    column_of = dict(zip(hypothesis.values, hypothesis.columns, strict=True))
    scaled = []
    values = []
    for term in varied:
        parameter = problem.parameters[term]
        change = float(np.sqrt((column_of[term][problem.used] ** 2).mean()))
        step = min(_STEP_OF_EFFECT, _STEP_OF_FLOOR * problem.floor / max(change, _LEAST_CHANGE))
        scaled_value = to_scaled(parameter, hypothesis.values[term])
        step = step if scaled_value + step <= to_scaled(parameter, parameter.high) else -step
        scaled.append(step)
        values.append(from_scaled(parameter, scaled_value + step))
    return np.array(scaled), values
