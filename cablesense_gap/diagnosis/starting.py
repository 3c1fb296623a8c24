"""From a first look to a fit: with which numbers a search begins."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

from cablesense_gap.diagnosis.course import Course
from cablesense_gap.diagnosis.hypothesis import Hypothesis
from cablesense_gap.diagnosis.looking import Look
from cablesense_gap.diagnosis.refining import refine
from cablesense_gap.diagnosis.scaled import to_scaled
from cablesense_gap.simulator import Candidate, Term
from cablesense_sim.effects.effect import Parameter

_STEPS, _STEPS_OF_DEAR_PAIRS = 8, 4
_SCALES = (0.4, 1.0, 2.5)


def fit(course: Course, look: Look) -> Hypothesis | None:
    """The look's effects as the simulator has them; None where that leads nowhere.

    An effect that remembers is begun with smaller and larger sizes too.
    """
    candidates = {c.effect: c for c in course.simulator.candidates}
    parameters, known = _known(candidates, look.beside)
    fresh, start = _fresh(candidates, look)
    parameters |= fresh
    remembering = [candidates[e] for e in look.effects if candidates[e].remembers]
    starts = [[*known, *start]]
    if look.beside is None:
        starts = [
            [*known, *_varied(fresh, start, candidates, scale, shapes)]
            for scale in (_SCALES if remembering else (1.0,))
            for shapes in _shapes(remembering)
        ]
    dear = remembering and len(look.effects) > 1
    return refine(
        course, parameters, starts, _STEPS_OF_DEAR_PAIRS if dear else _STEPS, look.most_left
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
) -> tuple[dict[Term, Parameter], list[float]]:
    parameters: dict[Term, Parameter] = {}
    start: list[float] = []
    coefficients = iter(look.placed.coefficients)
    for block in look.placed.blocks:
        change = {name: next(coefficients) for name in block.probed}
        own = {term: parameter_of(candidates, term) for term in block.terms}
        first = next(change[p.name] for p in own.values() if p.role == "size")
        for (term, parameter), begin in zip(own.items(), block.start, strict=True):
            parameters[term] = parameter
            start.append(_begin(parameter, begin, change, first))
    return parameters, start


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


def parameter_of(candidates: dict[str, Candidate], term: Term) -> Parameter:
    """What a number is, and within which range."""
    return next(p for p in candidates[term.effect].parameters if p.name == term.parameter)
