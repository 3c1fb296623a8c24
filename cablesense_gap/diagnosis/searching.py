"""The search among candidates: a first look at all, a fit of the promising, then pairs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from cablesense_gap.diagnosis.blocks import Block, blocks
from cablesense_gap.diagnosis.course import Course
from cablesense_gap.diagnosis.crew import Crew
from cablesense_gap.diagnosis.hypothesis import Hypothesis, excess
from cablesense_gap.diagnosis.placing import Placed, place
from cablesense_gap.diagnosis.refining import refine
from cablesense_gap.diagnosis.scaled import to_scaled
from cablesense_gap.simulator import Array, Candidate, Term
from cablesense_sim.effects.effect import Parameter

_MOST_SINGLES = 4
_PROMISING = 3.0
_MOST_PAIRS = 8
_MOST_DEAR_PAIRS = 2
_RESOLVED = 0.04
_STEPS, _STEPS_OF_PAIRS, _STEPS_OF_DEAR_PAIRS = 6, 4, 2
_BARELY = 1.25
_ALIKE = 1.02
_HOPELESS = 2.5
_SCALES = (0.4, 1.0, 2.5)


@dataclass(frozen=True)
class Look:
    """A first look at one candidate: its best places, linear about the nominal mechanism.

    A fit is not worth while if its starts leave a mean square of more than `most_left`.
    """

    candidate: Candidate
    placed: Placed
    most_left: float = np.inf


def search(
    course: Course, tell: Callable[[str, float], None] = lambda *_: None, workers: int = 1
) -> list[Hypothesis]:
    """Every hypothesis that was fitted, that of tolerances alone first.

    `tell` hears what is under way and which share of the whole is behind. With more than one
    worker, candidates are looked at and fitted in as many processes.
    """
    none = refine(course, {}, [[]])
    assert none is not None
    residual = course.readings - course.nominal
    nothing = np.empty((0, *residual.shape))
    candidates = sorted(course.simulator.candidates, key=lambda c: -c.remembers)
    with Crew(course, workers) as crew:
        offered: dict[str, tuple[Candidate, list[tuple[Block, ...]]]] = {}
        looks: list[Look] = []
        for k, (candidate, every) in enumerate(
            zip(candidates, crew.map(blocks, candidates), strict=True)
        ):
            tell(candidate.effect, 0.4 * k / len(candidates))
            offered[candidate.effect] = candidate, every
            looks += _looks(course, candidate, every, residual, nothing)
        looks.sort(key=lambda look: _forecast(look, course.floor, len(course.tolerance_terms)))
        barely = none.held_out_rmse <= _BARELY * course.floor
        promising = list(_promising(looks, course.floor, barely))
        singles: list[Hypothesis] = []
        for k, fitted in enumerate(crew.map(_fit_single, promising)):
            tell("fitting single effects", 0.4 + 0.3 * k / len(promising))
            if fitted is not None:
                singles.append(fitted)
        singles = _best_of_each(singles)
        found = [none, *singles]
        if singles and not barely and not _is_resolved(singles[0], none, course.floor):
            tell("fitting pairs of effects", 0.7)
            pairs = list(_pairs(course, singles, offered))
            for k, fitted in enumerate(crew.map(_fit_pair, pairs)):
                tell("fitting pairs of effects", 0.7 + 0.3 * k / len(pairs))
                if fitted is not None:
                    found.append(fitted)
    tell("done", 1.0)
    return found


def _best_of_each(fitted: list[Hypothesis]) -> list[Hypothesis]:
    """One hypothesis for each effect, the best first; among equals the least far-fetched."""
    best: dict[tuple[str, ...], Hypothesis] = {}
    for hypothesis in sorted(fitted, key=lambda h: h.held_out_rmse):
        known = best.setdefault(hypothesis.effects, hypothesis)
        alike = hypothesis.held_out_rmse <= _ALIKE * known.held_out_rmse
        if alike and hypothesis.strangeness < known.strangeness:
            best[hypothesis.effects] = hypothesis
    return list(best.values())


def _is_resolved(best: Hypothesis, none: Hypothesis, floor: float) -> bool:
    """Whether one effect leaves so little that a second has nothing to do."""
    gap = excess(none.held_out_rmse**2, floor)
    left = excess(best.held_out_rmse**2, floor)
    return left <= max(_RESOLVED * gap, 1.5 * excess(0.0, floor))


def _forecast(look: Look, floor: float, tolerances: int) -> float:
    """Small where little is left and tolerances need not help; weighed as in the belief."""
    left = excess(look.placed.mean_square, floor)
    usual = max(tolerances, 1)
    return 4.0 * float(np.log(left)) + 1.4 * float(np.log(max(look.placed.strain / usual, 1.0)))


def _promising(looks: list[Look], floor: float, barely: bool) -> Iterator[Look]:
    """Looks that a fit may yet bring to the front.

    What is linear about the nominal mechanism is a poor guide to effects that remember: these are
    tried beside the others, and do not crowd them out by what they promise.
    """
    plain = [look for look in looks if not look.candidate.remembers]
    best = min((excess(look.placed.mean_square, floor) for look in plain or looks), default=0.0)
    chosen = plain[:_MOST_SINGLES]
    if not barely:
        chosen += [look for look in looks if look.candidate.remembers]
    for look in chosen:
        if excess(look.placed.mean_square, floor) <= _PROMISING * best:
            yield replace(look, most_left=(_HOPELESS * best) ** 2 + floor**2)


def _looks(
    course: Course,
    candidate: Candidate,
    offered: list[tuple[Block, ...]],
    residual: Array,
    beside: Array,
) -> list[Look]:
    """The best places with the best of the starting shapes, and perhaps the second best."""
    placed = [p for some in offered if (p := place(course, residual, beside, some))]
    best = min(placed, key=lambda p: p[0].mean_square, default=[])
    return [Look(candidate, each) for each in best]


def _pairs(
    course: Course,
    singles: list[Hypothesis],
    offered: dict[str, tuple[Candidate, list[tuple[Block, ...]]]],
) -> Iterator[tuple[Hypothesis, Look]]:
    """Forward selection: the best second effects beside each of the two best."""
    looks: list[tuple[Hypothesis, Look]] = []
    for first in singles[:2]:
        residual = course.readings - first.prediction
        for candidate, every in offered.values():
            if candidate.effect in first.effects:
                continue
            found = _looks(course, candidate, every, residual, first.columns)
            looks += [(first, look) for look in found[:1]]
    looks.sort(key=lambda pair: _forecast(pair[1], course.floor, len(course.tolerance_terms)))
    names: set[frozenset[str]] = set()
    dear = 0
    for first, look in looks:
        named = frozenset((*first.effects, look.candidate.effect))
        remembers = look.candidate.remembers or any(_remembers(course, t) for t in first.values)
        if named in names or (remembers and dear == _MOST_DEAR_PAIRS):
            continue
        if len(names) == _MOST_PAIRS:
            return
        dear += remembers
        names.add(named)
        yield first, look


def _fit_single(course: Course, look: Look) -> Hypothesis | None:
    return _fit(course, None, look)


def _fit_pair(course: Course, pair: tuple[Hypothesis, Look]) -> Hypothesis | None:
    return _fit(course, *pair)


def _fit(course: Course, first: Hypothesis | None, look: Look) -> Hypothesis | None:
    """From the first look on; with an effect that remembers, from smaller and larger sizes too."""
    parameters, start = _start(course, first)
    found = len(start)
    coefficients = iter(look.placed.coefficients)
    for block in look.placed.blocks:
        change = {name: next(coefficients) for name in block.probed}
        sizes = [change[p.name] for p in look.candidate.parameters if p.role == "size"]
        for term, parameter, begin in zip(
            block.terms, look.candidate.parameters, block.start, strict=True
        ):
            parameters[term] = parameter
            start.append(_begin(parameter, begin, change, sizes[0]))
    starts = [start]
    if look.candidate.remembers and first is None:
        sizes = [p.role == "size" for p in list(parameters.values())[found:]]
        starts = [
            start[:found]
            + [
                max(abs(s), 0.1) * scale if size else shapes.get(p.name, s)
                for s, size, p in zip(
                    start[found:], sizes, list(parameters.values())[found:], strict=True
                )
            ]
            for scale in _SCALES
            for shapes in _shape_starts(look.candidate)
        ]
    steps = _STEPS
    if first is not None:
        dear = any(_remembers(course, term) for term in parameters)
        steps = _STEPS_OF_DEAR_PAIRS if dear else _STEPS_OF_PAIRS
    return refine(course, parameters, starts, steps, look.most_left)


def _begin(parameter: Parameter, begin: float, change: dict[str, float], size: float) -> float:
    """Sizes as the first look has them; shapes from what it adds beside a size of one."""
    if parameter.role == "size":
        return change[parameter.name]
    return begin + change.get(parameter.name, 0.0) / max(abs(size), 0.3)


def _remembers(course: Course, term: Term) -> bool:
    return any(c.remembers for c in course.simulator.candidates if c.effect == term.effect)


def _shape_starts(candidate: Candidate) -> list[dict[str, float]]:
    """Combinations of the shapes that a first look has not told apart."""
    shapes = [p for p in candidate.parameters if p.role == "shape" and p.trials]
    return [
        {p.name: to_scaled(p, value) for p, value in zip(shapes, values, strict=True)}
        for values in product(*(p.trials for p in shapes))
    ]


def _start(
    course: Course, first: Hypothesis | None
) -> tuple[dict[Term, Parameter], list[float]]:
    parameters: dict[Term, Parameter] = {}
    start: list[float] = []
    if first is not None:
        by_name = {c.effect: c for c in course.simulator.candidates}
        for term, value in first.values.items():
            parameter = next(
                p for p in by_name[term.effect].parameters if p.name == term.parameter
            )
            parameters[term] = parameter
            start.append(to_scaled(parameter, value))
    return parameters, start
