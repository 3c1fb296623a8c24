"""From a first look to a fit: with which numbers a search begins.

A last fit of a hypothesis, with the tolerances as they act on the amended mechanism.

Second thoughts on where a fitted hypothesis has its effects.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from cablesense_gap.diagnosis.gauss_newton import parameter_of, refine, refit
from cablesense_gap.diagnosis.places import WORTH
from cablesense_gap.diagnosis.problem import Course, Hypothesis, to_scaled
from cablesense_gap.diagnosis.screening import Look, Offered, single_looks
from cablesense_gap.simulator import Candidate, Term
from cablesense_sim.effects.effect import Parameter

_STEPS, _STEPS_OF_DEAR_PAIRS = 8, 4
_SCALES = (0.4, 1.0, 2.5)
_SCALES_UNTOLD = (0.3, 1.0, 3.0, 10.0)
"""In typical sizes, where a first look has found none that can be."""


def fit(course: Course, look: Look) -> Hypothesis | None:
    """The look's effects as the simulator has them; None where that leads nowhere.

    An effect that remembers is begun with smaller and larger sizes too.
    """
    candidates = {c.effect: c for c in course.simulator.candidates}
    parameters, known = _known(candidates, look.beside)
    fresh, start, impossible = _fresh(candidates, look)
    parameters |= fresh
    remembering = [candidates[e] for e in look.effects if candidates[e].remembers]
    starts = [[*known, *start]]
    if look.beside is None:
        starts = [
            [*known, *_varied(fresh, start, candidates, scale, shapes)]
            for scale in (_SCALES if remembering else (1.0,))
            for shapes in _shapes(remembering)
        ]
    if impossible:
        starts += [
            [*known, *_elsewhere(fresh, start, impossible, scale)] for scale in _SCALES_UNTOLD
        ]
    dear = remembering and len(look.effects) > 1
    most_left = look.most_left if remembering else np.inf
    return refine(
        course,
        parameters,
        starts,
        _STEPS_OF_DEAR_PAIRS if dear else _STEPS,
        most_left,
    )


def _known(
    candidates: dict[str, Candidate], beside: Hypothesis | None
) -> tuple[dict[Term, Parameter], list[float]]:
    if beside is None:
        return {}, []
    parameters = {term: parameter_of(candidates, term) for term in beside.values}
    return parameters, [to_scaled(parameters[t], value) for t, value in beside.values.items()]


def _fresh(
    candidates: dict[str, Candidate], look: Look
) -> tuple[dict[Term, Parameter], list[float], dict[Term, float]]:
    """Numbers, where to begin, and where instead for those of places with a size out of range."""
    parameters: dict[Term, Parameter] = {}
    start: list[float] = []
    impossible: dict[Term, float] = {}
    coefficients = iter(look.placed.coefficients)
    for block in look.placed.blocks:
        change = {name: next(coefficients) for name in block.probed}
        own = {term: parameter_of(candidates, term) for term in block.terms}
        first = next(change[p.name] for p in own.values() if p.role == "size")
        for (term, parameter), begin in zip(own.items(), block.start, strict=True):
            parameters[term] = parameter
            start.append(_begin(parameter, begin, change, first))
        if any(p.role == "size" and not _can_be(p, change[p.name]) for p in own.values()):
            impossible |= dict(zip(own, block.start, strict=True))
    return parameters, start, impossible


def _can_be(size: Parameter, scaled: float) -> bool:
    return size.low <= scaled * size.typical <= size.high


def _elsewhere(
    parameters: dict[Term, Parameter],
    start: list[float],
    impossible: dict[Term, float],
    scale: float,
) -> Iterator[float]:
    """The start with sizes of a scale where the look's cannot be, and their first shapes.

    That is so where shapes act unlike their derivatives: the look's best sum of both means
    nothing.
    """
    for (term, parameter), value in zip(parameters.items(), start, strict=True):
        if term not in impossible:
            yield value
        else:
            yield scale if parameter.role == "size" else impossible[term]


def _begin(parameter: Parameter, begin: float, change: dict[str, float], size: float) -> float:
    """Sizes as the first look has them; shapes from what it adds beside a size of one."""
    if parameter.role == "size":
        return change[parameter.name]
    return begin + change.get(parameter.name, 0.0) / max(abs(size), 0.3)


def _varied(
    parameters: dict[Term, Parameter],
    start: list[float],
    candidates: dict[str, Candidate],
    scale: float,
    shapes: dict[tuple[str, str], float],
) -> Iterator[float]:
    """The start with the sizes of what remembers scaled, and with some shapes put in."""
    for (term, parameter), value in zip(parameters.items(), start, strict=True):
        if not candidates[term.effect].remembers:
            yield value
        elif parameter.role == "size":
            yield max(abs(value), 0.1) * scale
        else:
            yield shapes.get((term.effect, term.parameter), value)


def _shapes(remembering: list[Candidate]) -> list[dict[tuple[str, str], float]]:
    """Combinations of the shapes that a first look has not told apart."""
    shapes = [
        (candidate.effect, p)
        for candidate in remembering
        for p in candidate.parameters
        if p.role == "shape" and p.trials
    ]
    return [
        {
            (effect, p.name): to_scaled(p, value)
            for (effect, p), value in zip(shapes, values, strict=True)
        }
        for values in product(*(p.trials for _, p in shapes))
    ]


_STEPS_POLISHING = 3


def polish(course: Course, hypothesis: Hypothesis) -> Hypothesis:
    """The same effects, fitted beside tolerances that are linear about these very effects.

    The search takes them linear about the nominal mechanism, which is near enough to choose by.
    """
    if not hypothesis.values:
        return hypothesis
    fitted = refit(_about(course, hypothesis), hypothesis.values, _STEPS_POLISHING)
    if fitted is None or course.cost_of(fitted) > course.cost_of(hypothesis):
        return hypothesis
    return fitted


def _about(course: Course, hypothesis: Hypothesis) -> Course:
    """The course with sensitivities to tolerances at the hypothesis."""
    absent = dict.fromkeys(course.tolerance_terms, 0.0)
    variants = [{**hypothesis.values, **absent}]
    for term, std in zip(course.tolerance_terms, course.tolerance_std, strict=True):
        variants.append({**variants[0], term: float(std)})
    predicted = course.simulator.predict(variants)
    columns = predicted[1:] - predicted[0]
    if not np.isfinite(columns).all():
        return course
    return replace(course, tolerance_columns=columns)


_ROUNDS = 2
_STEPS_RETHINKING = 4


def rethink(course: Course, hypothesis: Hypothesis, offered: Offered) -> Hypothesis:
    """The hypothesis with each of two effects looked at again beside the other as it is fitted.

    The places were chosen linear about the nominal mechanism, and beside effects that were not
    there yet. Of equal hypotheses the one with fewer places is given.
    """
    for _ in range(_ROUNDS):
        better = hypothesis
        for look in _again(course, hypothesis, offered):
            fitted = fit(course, look)
            if fitted is not None and course.cost_of(fitted) < course.cost_of(better):
                better = fitted
        if better is hypothesis:
            break
        hypothesis = better
    return _fewest(course, hypothesis)


def singled_out(course: Course, hypothesis: Hypothesis) -> Iterator[Hypothesis]:
    """Each of two effects alone, begun with its numbers beside the other.

    A search for one effect may end early where a second one then makes up for it.
    """
    if len(hypothesis.effects) < 2:
        return
    for effect in hypothesis.effects:
        own = {t: v for t, v in hypothesis.values.items() if t.effect == effect}
        fitted = refit(course, own, _STEPS_RETHINKING)
        if fitted is not None:
            yield fitted


def _again(course: Course, hypothesis: Hypothesis, offered: Offered) -> Iterator[Look]:
    if len(hypothesis.effects) < 2:
        return
    for effect in hypothesis.effects:
        others = {t: v for t, v in hypothesis.values.items() if t.effect != effect}
        beside = refit(course, others, 0)
        if beside is None or effect not in offered:
            continue
        for look in single_looks(course, {effect: offered[effect]}, beside):
            placed = {block.place for block in look.placed.blocks}
            if placed != {t.place for t in hypothesis.values if t.effect == effect}:
                yield look


def _fewest(course: Course, hypothesis: Hypothesis) -> Hypothesis:
    """Places are left out as long as what is left hardly grows."""
    sites = list(dict.fromkeys((term.effect, term.place) for term in hypothesis.values))
    cost = course.cost_of(hypothesis)
    for effect, place in reversed(sites):
        if sum(e == effect for e, _ in sites) == 1:
            continue
        rest = {t: v for t, v in hypothesis.values.items() if t[:2] != (effect, place)}
        fitted = refit(course, rest, _STEPS_RETHINKING)
        if fitted is None or course.cost_of(fitted) > WORTH * cost:
            continue
        hypothesis = fitted
        sites.remove((effect, place))
    return hypothesis
