"""The change of the readings by one effect in one place, linear in its scaled values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import chain, product

import numpy as np

from cablesense_base import Array
from cablesense_gap.diagnosis.problem import (
    Explanation,
    Problem,
    from_scaled,
    is_logarithmic,
    prior_precision,
    to_scaled,
)
from cablesense_gap.simulator import Assignment, Candidate, Term
from cablesense_sim.effects.effect import Parameter

_SHAPE_STEP = 0.3
"""Scaled change of a varied shape: well above the simulator's rounding, within its range."""


@dataclass(frozen=True)
class LinearEffect:
    """One effect in one place, linear in its scaled numbers.

    Attributes:
        terms: its numbers.
        start: scaled values of the terms at which a fit starts.
        columns: (K, R, C) sensitivities to each varied number.
        precision: (K,) of the priors.
        varied: (K,) terms that the columns belong to.
    """

    place: str
    terms: tuple[Term, ...]
    start: Array
    columns: Array
    precision: Array
    varied: tuple[Term, ...]

    @property
    def effect(self) -> str:
        """Its name."""
        return self.terms[0].effect


def linear_effects(
    problem: Problem, candidate: Candidate, about: Explanation | None = None
) -> list[LinearEffect]:
    """The candidate in every place, for each combination of starting shapes.

    It is linear about the nominal mechanism, or about an explanation without its history-dependent
    effects. Places that the explanation has already are left out, as are those with which the
    mechanism cannot be simulated. A history-dependent effect is simulated in all places and shapes
    in one call: its cost hardly depends on the number of variants.
    """
    everything = {} if about is None else dict(about.values)
    slow = {c.effect for c in problem.simulator.candidates if c.history_dependent}
    known = {term: value for term, value in everything.items() if term.effect not in slow}
    base = problem.nominal if about is None else about.without_tolerances
    if len(known) < len(everything):
        base = problem.simulator.predict([known])[0]
    taken = {term.place for term in everything if term.effect == candidate.effect}
    offered = [place for place in candidate.places if place not in taken]
    parameters = candidate.parameters
    first_values = [
        p.starts or (p.typical if p.role == "size" else p.default,) for p in parameters
    ]
    starts = [
        dict(zip((p.name for p in parameters), values, strict=True))
        for values in product(*first_values)
    ]
    absent = {p.name: 0.0 for p in parameters if p.role == "size"}
    # a number that is varied is a size, or a shape that may be zero
    varied = [p for p in parameters if p.role == "size" or not is_logarithmic(p)]

    def variant(place: str, start: dict[str, float], varied: Parameter) -> Assignment:
        among = offered if candidate.history_dependent else (place,)
        probe = _probe(candidate, start, varied)
        return known | {
            Term(candidate.effect, at, name): value
            for at in among
            for name, value in (start | absent | (probe if at == place else {})).items()
        }

    batches = [[variant(place, start, p) for p in varied] for start in starts for place in offered]
    if candidate.history_dependent:
        batches = [list(chain(*batches))]
    changes = (c for b in batches for c in problem.simulator.predict(b) - base)
    found = []
    for start, place in product(starts, offered):
        changed = np.array([next(changes) for _ in varied])
        if np.isfinite(changed).all():
            found.append(
                LinearEffect(
                    place=place,
                    terms=candidate.terms(place),
                    start=np.array(
                        [0.0 if p.role == "size" else to_scaled(p, start[p.name])
                         for p in parameters]
                    ),
                    columns=_columns(varied, start, changed),
                    precision=np.array([prior_precision(p) for p in varied]),
                    varied=tuple(Term(candidate.effect, place, p.name) for p in varied),
                )
            )  # fmt: skip
    return found


def _probe(
    candidate: Candidate, start: Mapping[str, float], varied: Parameter
) -> dict[str, float]:
    """Values that show the change by one number.

    A shape has an effect only with a size, so it is varied together with the first one.
    """
    if varied.role == "size":
        return {varied.name: start[varied.name]}
    first = next(p for p in candidate.parameters if p.role == "size")
    moved = to_scaled(varied, start[varied.name]) + _step(varied, start)
    return {first.name: start[first.name], varied.name: from_scaled(varied, moved)}


def _step(shape: Parameter, start: Mapping[str, float]) -> float:
    ahead = to_scaled(shape, start[shape.name]) + _SHAPE_STEP
    return _SHAPE_STEP if ahead * shape.typical <= shape.high else -_SHAPE_STEP


def _columns(varied: list[Parameter], start: Mapping[str, float], changes: Array) -> Array:
    """The mean change per unit of each number, up to the size that was simulated."""
    first = next(k for k, p in enumerate(varied) if p.role == "size")
    size = to_scaled(varied[first], start[varied[first].name])
    return np.array(
        [
            change / to_scaled(p, start[p.name])
            if p.role == "size"
            else (change - changes[first]) / (size * _step(p, start))
            for p, change in zip(varied, changes, strict=True)
        ]
    )


def own_columns(problem: Problem, fitted: Explanation) -> tuple[Explanation, list[LinearEffect]]:
    """An explanation as additions to the nominal mechanism, linear about it.

    Gives the base to add to and its sites; sizes that the fit held at zero are left out.
    """
    ranges = problem.parameters
    base = fitted.without_tolerances
    for column, (term, value) in zip(fitted.columns, fitted.values.items(), strict=True):
        if ranges[term].role == "size":
            base = base - to_scaled(ranges[term], value) * column
    sites = []
    for site in fitted.sites:
        own = {
            term: k
            for k, (term, value) in enumerate(fitted.values.items())
            if term[:2] == site and (value != 0.0 or ranges[term].low < 0.0)
        }
        if terms := tuple(own):
            precision = np.array([prior_precision(ranges[term]) for term in terms])
            columns, none = fitted.columns[list(own.values())], np.zeros(len(own))
            sites.append(LinearEffect(site[1], terms, none, columns, precision, terms))
    nothing = replace(
        fitted, effects=(), values={}, columns=fitted.columns[:0], without_tolerances=base
    )
    return nothing, sites
