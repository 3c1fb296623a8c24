"""What an effect of typical size would change, place by place: the columns of a first look."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from cablesense_gap.diagnosis.course import Course
from cablesense_gap.diagnosis.scaled import (
    from_scaled,
    is_logarithmic,
    prior_precision,
    to_scaled,
)
from cablesense_gap.simulator import Array, Candidate, Term
from cablesense_sim.effects.effect import Parameter

_SHAPE_STEP = 0.3


@dataclass(frozen=True)
class Block:
    """One effect in one place, linear in its scaled numbers.

    Attributes:
        place: where.
        terms: its numbers.
        start: scaled values of the terms to begin a search with.
        columns: (K, R, C) what each scaled number changes.
        precision: (K,) of the priors.
        probed: (K,) names of the parameters that the columns belong to.
    """

    place: str
    terms: tuple[Term, ...]
    start: Array
    columns: Array
    precision: Array
    probed: tuple[str, ...]


def blocks(course: Course, candidate: Candidate) -> list[tuple[Block, ...]]:
    """For each combination of starting shapes, a block for every place.

    Places that the mechanism cannot be simulated with are left out.
    """
    shapes = [p for p in candidate.parameters if p.role == "shape"]
    combinations = [
        dict(zip((p.name for p in shapes), starts, strict=True))
        for starts in product(*(p.starts or (p.default,) for p in shapes))
    ]
    look = _together if candidate.remembers else _one_by_one
    return [
        tuple(block for block in found if np.isfinite(block.columns).all())
        for found in look(course, candidate, combinations)
    ]


def _probes(
    candidate: Candidate, shape: dict[str, float]
) -> list[tuple[Parameter, dict[str, float]]]:
    """Parameters that a first look takes as linear, each with values that show what it changes.

    Those are the sizes, and such shapes as may be zero. A shape has an effect only where there is
    a size: it is looked at beside the first one.
    """
    first = next(p for p in candidate.parameters if p.role == "size")
    found = []
    for parameter in candidate.parameters:
        if parameter.role == "size":
            found.append((parameter, shape | {parameter.name: parameter.typical}))
        elif not is_logarithmic(parameter):
            moved = to_scaled(parameter, shape[parameter.name]) + _step(parameter, shape)
            there = {first.name: first.typical, parameter.name: from_scaled(parameter, moved)}
            found.append((parameter, shape | there))
    return found


def _step(parameter: Parameter, shape: dict[str, float]) -> float:
    ahead = to_scaled(parameter, shape[parameter.name]) + _SHAPE_STEP
    return _SHAPE_STEP if ahead * parameter.typical <= parameter.high else -_SHAPE_STEP


def _one_by_one(
    course: Course, candidate: Candidate, combinations: list[dict[str, float]]
) -> Iterator[list[Block]]:
    absent = {p.name: 0.0 for p in candidate.parameters if p.role == "size"}
    for shape in combinations:
        found = []
        for place in candidate.places:
            variants = [
                {Term(candidate.effect, place, k): v for k, v in (absent | probe).items()}
                for _, probe in _probes(candidate, shape)
            ]
            changes = course.simulator.predict(variants) - course.nominal
            found.append(_as_block(candidate, place, shape, changes))
        yield found


def _together(
    course: Course, candidate: Candidate, combinations: list[dict[str, float]]
) -> Iterator[list[Block]]:
    """All places and shapes side by side, which an effect that remembers makes worth while."""
    absent = {p.name: 0.0 for p in candidate.parameters if p.role == "size"}
    variants = [
        {
            Term(candidate.effect, other, k): v
            for other in candidate.places
            for k, v in (absent | (probe if other == place else shape)).items()
        }
        for shape in combinations
        for place in candidate.places
        for _, probe in _probes(candidate, shape)
    ]
    changes = iter(course.simulator.predict(variants) - course.nominal)
    for shape in combinations:
        count = len(_probes(candidate, shape))
        yield [
            _as_block(candidate, place, shape, np.array([next(changes) for _ in range(count)]))
            for place in candidate.places
        ]


def _as_block(candidate: Candidate, place: str, shape: dict[str, float], changes: Array) -> Block:
    probed = [parameter for parameter, _ in _probes(candidate, shape)]
    first = next(k for k, p in enumerate(probed) if p.role == "size")
    columns = [
        change if p.role == "size" else (change - changes[first]) / _step(p, shape)
        for p, change in zip(probed, changes, strict=True)
    ]
    start = [
        0.0 if p.role == "size" else to_scaled(p, shape[p.name]) for p in candidate.parameters
    ]
    return Block(
        place,
        candidate.terms(place),
        np.array(start),
        np.array(columns),
        np.array([prior_precision(p) for p in probed]),
        tuple(p.name for p in probed),
    )
