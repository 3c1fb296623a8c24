"""Where an effect sits: places are added while they explain trials that were not fitted.

What an effect of typical size would change, place by place: the columns of a first look.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from cablesense_base.arrays import Array
from cablesense_gap.diagnosis.evidence import Products, held_out_squares, products, solve, weight
from cablesense_gap.diagnosis.problem import (
    Course,
    from_scaled,
    is_logarithmic,
    prior_precision,
    to_scaled,
)
from cablesense_gap.simulator import Candidate, Term
from cablesense_sim.effects.effect import WHOLE_ARM, Parameter

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


WORTH = 1.12
"""A further place must make what is left smaller by this factor."""

MOST_IN_TWOS = 12
"""With so many places or fewer left, two at a time are tried where one is not worth it."""

_LOOKED_AT = 6
_NEARLY = 1.5


@dataclass(frozen=True)
class Placed:
    """An effect in the places that explain most.

    Attributes:
        blocks: chosen, in the order in which they were found.
        coefficients: (K,) of their columns, scaled.
        squares: (T,) left in each held-out trial.
        mean_square: of all that is left.
        strain: sum of the squares of the tolerances beside them, in standard deviations.
    """

    blocks: tuple[Block, ...]
    coefficients: Array
    squares: Array
    mean_square: float
    strain: float


def place(
    course: Course, residual: Array, beside: Array, offered: Sequence[Block]
) -> list[Placed]:
    """The best places for one effect, at least one, if any is offered.

    Where that is a single place, the second best single place follows if it explains nearly as
    much: a search from there may yet end better.

    `residual` (R, C) is what is to be explained, `beside` (B, R, C) are scaled columns of effects
    already found, which are fitted along with the tolerances.
    """
    if not offered:
        return []
    columns = np.concatenate([course.tolerance_columns, beside, *(b.columns for b in offered)])
    data = products(columns, residual, course.trial, course.used)
    base = len(course.tolerance_columns) + len(beside)
    precision = np.concatenate([np.ones(base), *(b.precision for b in offered)])
    ends = base + np.cumsum([len(b.columns) for b in offered])
    owned = [np.arange(e - len(b.columns), e) for e, b in zip(ends, offered, strict=True)]
    search = Placing(course, data, precision, np.arange(base), owned)
    whole = [k for k, b in enumerate(offered) if b.place == WHOLE_ARM]
    single = [k for k, b in enumerate(offered) if b.place != WHOLE_ARM]
    paths = [search.grow(among) for among in (whole, single) if among]
    best = min(paths, key=lambda path: path[1])
    if len(paths) == 2 and paths[0][0] and paths[0][1] < WORTH * paths[1][1]:
        best = paths[0]
    found = [best]
    if len(best[0]) == 1:
        others = [search.grow([k], most=1) for k in range(len(offered)) if k != best[0][0]]
        found += sorted(others, key=lambda path: path[1])[:1]
    return [search.placed(chosen, offered) for chosen, left in found if left <= _NEARLY * best[1]]


class Placing:
    """Blocks of columns among which places are chosen, with a base that is always fitted along."""

    def __init__(
        self,
        course: Course,
        data: Products,
        precision: Array,
        base: NDArray[np.int64],
        owned: Sequence[NDArray[np.int64]],
    ) -> None:
        """`owned` are the columns of each block, `base` those of tolerances and what is known."""
        self._course, self._data, self._precision = course, data, precision
        self._base, self._owned = base, owned
        self._gram, self._moment = data.gram.sum(0), data.moment.sum(0)
        self._weight = weight(data.mean_square, course.floor)

    def grow(self, among: Sequence[int], most: int = 99) -> tuple[list[int], float]:
        """Blocks added one by one, and the cost of what is left.

        Where one more is not worth it two more may be: of two cables that pull against each
        other, either alone may explain nothing.
        """
        chosen: list[int] = []
        left = self._left(chosen)
        while len(chosen) < min(len(among), most):
            tried, now = self._one_more(chosen, among)
            worth = WORTH
            if chosen and now * WORTH > left and len(chosen) + 2 <= most:
                tried, now = self._two_more(chosen, among)
                worth = WORTH**2
            if chosen and now * worth > left:
                break
            chosen, left = tried, now
        return chosen, left

    def _one_more(self, chosen: Sequence[int], among: Sequence[int]) -> tuple[list[int], float]:
        rest = [k for k in among if k not in chosen]
        ranked = sorted(rest, key=lambda k: self._gain(chosen, k), reverse=True)[:_LOOKED_AT]
        return self._best([[*chosen, k] for k in ranked])

    def _two_more(self, chosen: Sequence[int], among: Sequence[int]) -> tuple[list[int], float]:
        rest = [k for k in among if k not in chosen]
        if len(rest) > MOST_IN_TWOS:
            return list(chosen), np.inf
        return self._best([[*chosen, *two] for two in combinations(rest, 2)])

    def _best(self, options: Sequence[list[int]]) -> tuple[list[int], float]:
        tried = [self._left(option) for option in options]
        return (options[int(np.argmin(tried))], min(tried)) if tried else ([], np.inf)

    def placed(self, chosen: Sequence[int], offered: Sequence[Block]) -> Placed:
        """The chosen blocks with their coefficients and what they leave."""
        at = self._columns(chosen)
        part, precision = self._data.columns(at), self._precision[at]
        none = np.zeros(len(at))
        weight_ = weight(self._mean_square(part, precision, self._weight), self._course.floor)
        found = self._solved(part, precision, weight_)
        squares = held_out_squares(part, precision, none, weight_, self._course.fold)
        return Placed(
            tuple(offered[k] for k in chosen),
            found[len(self._base) :],
            squares,
            float(squares.sum() / part.count.sum()),
            self._strain(found),
        )

    def _left(self, chosen: Sequence[int]) -> float:
        at = self._columns(chosen)
        part, precision = self._data.columns(at), self._precision[at]
        first = self._mean_square(part, precision, self._weight)
        weight_ = weight(first, self._course.floor)
        found = self._solved(part, precision, weight_)
        return self._course.cost(self._mean_square(part, precision, weight_), self._strain(found))

    def _solved(self, part: Products, precision: Array, weight_: float) -> Array:
        none = np.zeros(len(precision))
        return solve(part.gram.sum(0), part.moment.sum(0), precision, none, weight_)

    def _strain(self, found: Array) -> float:
        return float((found[: len(self._course.tolerance_terms)] ** 2).sum())

    def _mean_square(self, part: Products, precision: Array, weight_: float) -> float:
        none = np.zeros(len(precision))
        squares = held_out_squares(part, precision, none, weight_, self._course.fold)
        return float(squares.sum() / part.count.sum())

    def _gain(self, chosen: Sequence[int], k: int) -> float:
        """Decrease of the sum of squares over all trials, if only block k moved."""
        at, own = self._columns(chosen), self._owned[k]
        found = solve(
            self._gram[np.ix_(at, at)],
            self._moment[at],
            self._precision[at],
            np.zeros(len(at)),
            self._weight,
        )
        moment = self._moment[own] - self._gram[np.ix_(own, at)] @ found
        gram = self._gram[np.ix_(own, own)]
        gram = gram + 1e-9 * np.trace(gram) * np.eye(len(own)) + 1e-12 * np.eye(len(own))
        return float(moment @ np.linalg.solve(gram, moment))

    def _columns(self, chosen: Sequence[int]) -> NDArray[np.int64]:
        return np.concatenate([self._base, *(self._owned[k] for k in chosen)])
