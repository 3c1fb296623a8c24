"""Explanations that a recording cannot tell apart, and why it cannot.

Two effects look alike where one can imitate what the other changes in the readings: tolerances
may help, as far as a workshop would leave them, and its numbers are free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.diagnosis.belief import Belief
from cablesense_gap.diagnosis.evidence import weight
from cablesense_gap.diagnosis.problem import Course, Hypothesis

LEAST, NEAR_BEST = 0.1, 0.2
"""A rival has at least this probability, and this share of that of the best."""
PARALLEL = 0.75
"""What can be imitated to this share is not told apart by its shape."""
_SLIGHT = 1e-6


@dataclass(frozen=True)
class Ambiguity:
    """Explanations between which the recording does not decide.

    Attributes:
        group: names of effects, joined by `+` where there are several; the best first.
        reasons: one plain sentence for each rival of the best.
    """

    group: tuple[str, ...]
    reasons: tuple[str, ...]


def ambiguity(course: Course, ranked: Sequence[Belief], unit: str = "N") -> Ambiguity:
    """The group of the best explanation, alone where it is clear.

    `none` and an unlisted effect change nothing that could be compared: they stand alone, and are
    in nobody's group. `unit` is that of the channels.
    """
    best, rivals = ranked[0], rivals_of(ranked)
    return Ambiguity(
        group=tuple("+".join(belief.effects) for belief in (best, *rivals)),
        reasons=tuple(_reason(course, best, rival, unit) for rival in rivals),
    )


def rivals_of(ranked: Sequence[Belief]) -> tuple[Belief, ...]:
    """Explanations too probable to be dismissed beside the best, which is `ranked[0]`."""
    best = ranked[0]
    if not _changes_something(best):
        return ()
    least = max(LEAST, NEAR_BEST * best.probability)
    return tuple(b for b in ranked[1:] if b.probability >= least and _changes_something(b))


def imitated_share(course: Course, one: Hypothesis, other: Hypothesis) -> float:
    """Share of what one explanation changes that the other can imitate, 0 to 1.

    Of the root mean square of the change, tolerances taken out; the other's numbers are free.
    """
    weight_ = _weight(course, one)
    change = _beyond_tolerances(course, one, weight_)
    whole = float(change @ change)
    if whole == 0.0:
        return 1.0
    own = np.array([_change(course, other), *other.columns])
    columns = np.array([_project(course, column, weight_) for column in own])
    gram = columns @ columns.T
    gram += _SLIGHT * np.diag(gram.diagonal()) + np.finfo(float).tiny * np.eye(len(gram))
    moment = columns @ change
    left = whole - float(moment @ np.linalg.lstsq(gram, moment, rcond=None)[0])
    return 1.0 - float(np.sqrt(np.clip(left / whole, 0.0, 1.0)))


def _reason(course: Course, best: Belief, rival: Belief, unit: str) -> str:
    assert best.hypothesis is not None
    assert rival.hypothesis is not None
    small, large = sorted((best, rival), key=lambda belief: len(belief.effects))
    if set(small.effects) < set(large.effects):
        return _one_more(course, small, large, unit)
    names = "+".join(best.effects), "+".join(rival.effects)
    share = imitated_share(course, best.hypothesis, rival.hypothesis)
    size = _rms(course, best.hypothesis)
    imitates = (
        f"{names[1]}, with numbers of its own, imitates {100.0 * share:.0f} % of the "
        f"{size:.2g} {unit} by which {names[0]} changes the readings beyond tolerances"
    )
    if share >= PARALLEL:
        return f"{imitates}: this recording shows both alike."
    return (
        f"{imitates}, so they differ; yet they leave {best.hypothesis.held_out_rmse:.2g} and "
        f"{rival.hypothesis.held_out_rmse:.2g} {unit} on trials that they have not seen, too near "
        f"each other to choose (the noise floor is {course.floor:.2g} {unit})."
    )


def _one_more(course: Course, small: Belief, large: Belief, unit: str) -> str:
    """Of two explanations, one of which has the effects of the other and more."""
    assert small.hypothesis is not None
    assert large.hypothesis is not None
    more = "+".join(name for name in large.effects if name not in small.effects)
    left = small.hypothesis.held_out_rmse, large.hypothesis.held_out_rmse
    return (
        f"Beside {'+'.join(small.effects)}, {more} takes what is left on trials that the fit has "
        f"not seen from {left[0]:.3g} to {left[1]:.3g} {unit}, with a noise floor of "
        f"{course.floor:.2g} {unit}: too little to be sure that it is there."
    )


def _changes_something(belief: Belief) -> bool:
    return belief.hypothesis is not None and bool(belief.hypothesis.effects)


def _weight(course: Course, hypothesis: Hypothesis) -> float:
    return weight(hypothesis.held_out_rmse**2, course.floor)


def _rms(course: Course, hypothesis: Hypothesis) -> float:
    change = _beyond_tolerances(course, hypothesis, _weight(course, hypothesis))
    return float(np.sqrt((change**2).sum() / (course.used.sum() * course.nominal.shape[1])))


def _change(course: Course, hypothesis: Hypothesis) -> Array:
    """(R, C) what the effects change, at their fitted numbers."""
    scaled = [
        hypothesis.tolerances.get(term, 0.0) / std
        for term, std in zip(course.tolerance_terms, course.tolerance_std, strict=True)
    ]
    of_tolerances = np.tensordot(np.array(scaled), course.tolerance_columns, axes=1)
    return np.asarray(hypothesis.prediction - of_tolerances - course.nominal)


def _beyond_tolerances(course: Course, hypothesis: Hypothesis, weight_: float) -> Array:
    return _project(course, _change(course, hypothesis), weight_)


def _project(course: Course, change: Array, weight_: float) -> Array:
    """Over the used rows, flat: what tolerances leave of a change, at the cost of their priors.

    The priors' cost is part of the vector, so that the products of two of them are those of the
    readings' marginal likelihood.
    """
    tolerances = course.tolerance_columns[:, course.used]
    flat = tolerances.reshape(len(tolerances), int(course.used.sum()) * change.shape[1])
    target = change[course.used].ravel()
    moment = flat @ target
    found = np.linalg.solve(flat @ flat.T + np.eye(len(flat)) / weight_, moment)
    return np.concatenate([target - found @ flat, found / np.sqrt(weight_)])
