"""The search among candidates: a first look at all, a fit of the promising, then pairs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from cablesense_gap.diagnosis.blocks import Block, blocks
from cablesense_gap.diagnosis.course import Course
from cablesense_gap.diagnosis.hypothesis import Hypothesis, excess
from cablesense_gap.diagnosis.placing import Placed, place
from cablesense_gap.diagnosis.refining import refine
from cablesense_gap.simulator import Array, Candidate, Term
from cablesense_sim.effects.effect import Parameter

_MOST_SINGLES = 5
_PROMISING = 3.0
_MOST_PAIRS = 4
_RESOLVED = 0.04


@dataclass(frozen=True)
class Look:
    """A first look at one candidate: its best places, linear about the nominal mechanism."""

    candidate: Candidate
    placed: Placed


def search(course: Course, tell: Callable[[str], None] = lambda _: None) -> list[Hypothesis]:
    """Every hypothesis that was fitted, that of tolerances alone first."""
    tell("tolerances alone")
    none = refine(course, {}, [])
    assert none is not None
    residual = course.readings - course.nominal
    offered: dict[str, tuple[Candidate, list[tuple[Block, ...]]]] = {}
    looks: list[Look] = []
    for candidate in course.simulator.candidates:
        tell(candidate.effect)
        every = blocks(course, candidate)
        offered[candidate.effect] = candidate, every
        look = _look(course, candidate, every, residual, np.empty((0, *residual.shape)))
        if look is not None:
            looks.append(look)
    looks.sort(key=lambda look: look.placed.mean_square)
    singles: list[Hypothesis] = []
    for look in _promising(looks, course.floor):
        tell(f"{look.candidate.effect}, fitted")
        fitted = _fit(course, None, look)
        if fitted is not None:
            singles.append(fitted)
    singles.sort(key=lambda h: h.held_out_rmse)
    found = [none, *singles]
    gap = excess(none.held_out_rmse**2, course.floor)
    if singles and excess(singles[0].held_out_rmse**2, course.floor) > max(
        _RESOLVED * gap, 1.5 * excess(0.0, course.floor)
    ):
        found += _pairs(course, singles, offered, tell)
    return found


def _promising(looks: list[Look], floor: float) -> Iterator[Look]:
    if looks:
        best = excess(looks[0].placed.mean_square, floor)
        for look in looks[:_MOST_SINGLES]:
            if excess(look.placed.mean_square, floor) <= _PROMISING * best:
                yield look


def _look(
    course: Course,
    candidate: Candidate,
    offered: list[tuple[Block, ...]],
    residual: Array,
    beside: Array,
) -> Look | None:
    placed = [p for some in offered if some and (p := place(course, residual, beside, some))]
    if not placed:
        return None
    return Look(candidate, min(placed, key=lambda p: p.mean_square))


def _pairs(
    course: Course,
    singles: list[Hypothesis],
    offered: dict[str, tuple[Candidate, list[tuple[Block, ...]]]],
    tell: Callable[[str], None],
) -> list[Hypothesis]:
    """Forward selection: a second effect beside each of the two best."""
    looks: list[tuple[Hypothesis, Look]] = []
    for first in singles[:2]:
        residual = course.readings - first.prediction
        for candidate, every in offered.values():
            if candidate.effect in first.effects:
                continue
            look = _look(course, candidate, every, residual, first.columns)
            if look is not None:
                looks.append((first, look))
    looks.sort(key=lambda pair: pair[1].placed.mean_square)
    found: dict[tuple[str, ...], Hypothesis] = {}
    for first, look in looks:
        names = tuple(sorted((*first.effects, look.candidate.effect)))
        if names in found:
            continue
        if len(found) == _MOST_PAIRS:
            break
        tell(f"{' and '.join(names)}, fitted")
        fitted = _fit(course, first, look)
        if fitted is not None:
            found[names] = fitted
    return list(found.values())


def _fit(course: Course, first: Hypothesis | None, look: Look) -> Hypothesis | None:
    parameters, start = _start(course, first)
    coefficients = iter(look.placed.coefficients)
    for block in look.placed.blocks:
        change = {name: next(coefficients) for name in block.probed}
        for term, parameter, begin in zip(
            block.terms, look.candidate.parameters, block.start, strict=True
        ):
            parameters[term] = parameter
            start.append(change[parameter.name] if parameter.role == "size" else begin)
    return refine(course, parameters, start)


def _start(
    course: Course, first: Hypothesis | None
) -> tuple[dict[Term, Parameter], list[float]]:
    from cablesense_gap.diagnosis.scaled import to_scaled

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
