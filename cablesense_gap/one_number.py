"""Explanations with one number, tried over its whole plausible range.

A handful of readings bears no more. The range is gone through value by value, so that an effect
that only acts from some size on, such as a cable that goes slack, is not missed for a slope of
zero.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.simulator import Array, Assignment, Candidate, Simulator, Term

VALUES = 81

_AS_GOOD = 1.001
"""Of values that leave no more than this times the least, the one nearest zero is taken."""


@dataclass(frozen=True)
class OneNumber:
    """One value in one or several places, all else held.

    Attributes:
        terms: that take the value.
        low, high: its plausible range; zero, which is within it, means that nothing is different.
        held: numbers that say how the effect behaves where it is present.
    """

    terms: tuple[Term, ...]
    low: float
    high: float
    held: Mapping[Term, float] = field(default_factory=dict)

    @property
    def effect(self) -> str:
        """Name of the effect."""
        return self.terms[0].effect

    def at(self, value: float) -> Assignment:
        """What a simulator is told."""
        return {**self.held, **dict.fromkeys(self.terms, value)}

    def values(self) -> Array:
        """(V,) over the range, denser about zero, with zero among them."""
        even = np.linspace(-1.0, 1.0, VALUES)
        return np.unique(np.where(even < 0.0, -self.low, self.high) * even * np.abs(even))


@dataclass(frozen=True)
class Scan:
    """What a simulator predicts over the range of one number.

    Attributes:
        number: which.
        values: (V,) those that can be simulated.
        predicted: (V, R, C).
    """

    number: OneNumber
    values: Array
    predicted: Array


@dataclass(frozen=True)
class Explained:
    """How far one number explains readings.

    Attributes:
        number: which.
        value: that fits all rows best.
        rmse: what it leaves of them.
        squares: (R,) sum of squares left in each row by the value that fits the other folds best.
        held_out_rmse: the same over all rows.
    """

    number: OneNumber
    value: float
    rmse: float
    squares: Array
    held_out_rmse: float


def numbers_of(candidate: Candidate) -> Iterator[OneNumber]:
    """Every size of a candidate in every place, with every shape from which a fit should begin."""
    shapes = [p for p in candidate.parameters if p.role == "shape"]
    trials = list(product(*(p.trials or p.starts or (p.default,) for p in shapes)))
    for place in candidate.places:
        for size in (p for p in candidate.parameters if p.role == "size"):
            for shape in trials:
                held = {Term(candidate.effect, place, p.name): 0.0 for p in candidate.parameters}
                for parameter, value in zip(shapes, shape, strict=True):
                    held[Term(candidate.effect, place, parameter.name)] = value
                term = Term(candidate.effect, place, size.name)
                yield OneNumber((term,), size.low, size.high, held)


def scan(simulator: Simulator, number: OneNumber) -> Scan:
    """Predict over the whole range; values that cannot be simulated are left out."""
    values = number.values()
    predicted = simulator.predict([number.at(float(value)) for value in values])
    usable = np.isfinite(predicted).all(axis=(1, 2))
    return Scan(number, values[usable], predicted[usable])


def most_change(found: Scan, nominal: Array) -> float:
    """Largest root mean square (over all readings) by which the number can change them."""
    return float(np.sqrt(((found.predicted - nominal) ** 2).mean(axis=(1, 2)).max(initial=0.0)))


def explain(found: Scan, readings: Array, fold: NDArray[np.int64]) -> Explained:
    """The value that fits best, and what values leave on rows that they were not fitted to.

    `fold` (R,) 0 to F - 1 says which rows are held out together.
    """
    squares = _squares(found, readings)
    best = _choice(squares.sum(-1), found.values)
    held_out = held_out_of_best([found], readings, fold)
    return Explained(
        number=found.number,
        value=float(found.values[best]),
        rmse=float(np.sqrt(squares[best].sum() / readings.size)),
        squares=held_out,
        held_out_rmse=float(np.sqrt(held_out.sum() / readings.size)),
    )


def held_out_of_best(scans: Sequence[Scan], readings: Array, fold: NDArray[np.int64]) -> Array:
    """(R,) squares left where the number itself, not only its value, was chosen on other folds."""
    every = [_squares(found, readings) for found in scans]
    left = np.empty(len(readings))
    for k in range(int(fold.max()) + 1):
        out = fold == k
        seen = [squares[:, ~out].sum(-1) for squares in every]
        best = int(np.argmin([squares.min() for squares in seen]))
        left[out] = every[best][_choice(seen[best], scans[best].values)][out]
    return left


def _squares(found: Scan, readings: Array) -> Array:
    return np.asarray(((readings - found.predicted) ** 2).sum(-1))


def _choice(squares: Array, values: Array) -> int:
    """Where a number changes nothing, or no more from some value on, less of it is the better."""
    good = np.flatnonzero(squares <= _AS_GOOD * squares.min())
    return int(good[np.argmin(np.abs(values[good]))])
