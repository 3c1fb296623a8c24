"""The simulator fits the additions that were scored linearly."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from cablesense_gap.diagnosis.columns import own_columns
from cablesense_gap.diagnosis.gauss_newton import MOST_STEPS, refine, refit, refit_part
from cablesense_gap.diagnosis.problem import Explanation, Problem, to_scaled
from cablesense_gap.diagnosis.selection import Proposal, Selection
from cablesense_gap.simulator import Candidate, Term

_SCALES = (0.3, 1.0, 3.0)
"""In typical sizes: where a fit starts if linear columns say little about the size."""
_STEPS_OF_PART = 3
"""Of Gauss-Newton: a part of an explanation is near its best values already."""


def fit(problem: Problem, proposal: Proposal) -> list[Explanation]:
    """Fit the additions; gives the explanation with them, and without sites that earn too little.

    Nothing if the simulator cannot follow. A history-dependent effect starts with smaller and
    larger sizes too, and with every combination of the shapes that its columns do not distinguish.
    """
    ranges, known = problem.parameters, proposal.beside.values
    start, impossible = _start(problem, proposal)
    before = [to_scaled(ranges[term], value) for term, value in known.items()]
    names = {term.effect for term in (*known, *start)}
    slow = [c for c in problem.simulator.candidates if c.history_dependent and c.effect in names]
    starts = [[*before, *start.values()]]
    if slow and not known:
        starts = [list(each.values()) for each in _elsewhere(problem, start, slow)]
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
    return [] if fitted is None else _with_fewer_sites(problem, fitted)


def refitted(problem: Problem, explanation: Explanation) -> list[Explanation]:
    """An explanation fitted until it converges, and without sites that earn too little."""
    fitted = refit(problem, explanation.values, 2 * MOST_STEPS)
    return [] if fitted is None else _with_fewer_sites(problem, fitted)


def _with_fewer_sites(problem: Problem, fitted: Explanation) -> list[Explanation]:
    """The explanation, and one with the sites alone that are worth their penalty."""
    nothing, sites = own_columns(problem, fitted)
    kept = {sites[k].terms[0][:2] for k in Selection(problem, nothing, sites).kept()}
    values = {term: v for term, v in fitted.values.items() if not kept or term[:2] in kept}
    smaller = None
    if len(values) < len(fitted.values):
        smaller = refit_part(problem, fitted, values, _STEPS_OF_PART)
    return [fitted, smaller] if smaller else [fitted]


def without(
    problem: Problem, effects: Sequence[str], explanation: Explanation
) -> Explanation | None:
    """An explanation without some of its effects, fitted again; None if it cannot be simulated."""
    kept = {t: v for t, v in explanation.values.items() if t.effect not in effects}
    return refit_part(problem, explanation, kept, _STEPS_OF_PART)


def _start(problem: Problem, proposal: Proposal) -> tuple[dict[Term, float], dict[Term, float]]:
    """Scaled values to start at, and others for the places with a size out of its range."""
    ranges = problem.parameters
    start: dict[Term, float] = {}
    impossible: dict[Term, float] = {}
    coefficients = iter(proposal.coefficients)
    for effect in proposal.added:
        change = {term: next(coefficients) for term in effect.varied}
        sizes = [term for term in effect.terms if ranges[term].role == "size"]
        first = max(abs(change[sizes[0]]), 0.3)
        for term, at in zip(effect.terms, effect.start, strict=True):
            # the column of a shape is its effect at a size of one
            added = change.get(term, 0.0)
            start[term] = added if ranges[term].role == "size" else at + added / first
        for term in sizes:
            low, high = (to_scaled(ranges[term], v) for v in (ranges[term].low, ranges[term].high))
            if not low <= change[term] <= high:
                impossible |= dict(zip(effect.terms, effect.start, strict=True))
    return start, impossible


def _elsewhere(
    problem: Problem, start: Mapping[Term, float], slow: Sequence[Candidate]
) -> Iterator[dict[Term, float]]:
    """The start with other sizes of the effects `slow`, and with every combination of shapes."""
    ranges, own = problem.parameters, {c.effect for c in slow}
    shapes: list[dict[tuple[str, str], float]] = []
    for candidate in slow:
        free = [p for p in candidate.parameters if p.role == "shape" and p.trials]
        names = [(candidate.effect, p.name) for p in free]
        scaled = [[to_scaled(p, value) for value in p.trials] for p in free]
        shapes += [dict(zip(names, values, strict=True)) for values in product(*scaled)]
    for scale, shape in product(_SCALES, shapes or [{}]):
        yield {
            term: value
            if term.effect not in own
            else max(abs(value), 0.1) * scale
            if ranges[term].role == "size"
            else shape.get((term.effect, term.parameter), value)
            for term, value in start.items()
        }
