"""Changes of the tensions under loads hung on the arm, and explanations of them by one number.

A change is a loaded reading minus the unloaded one just before it. Effects that are the same in
both, such as a sensor's zero or the arm's own weight, cancel.

A handful of readings bears explanations with one number and no more. Its range is gone through
value by value, so that an effect that only acts from some size on, such as a cable that goes
slack, is not missed for a slope of zero.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.simulator import Assignment, Candidate, Simulator, Term
from cablesense_recording.recording import Recording
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.effects.registry import known_effects
from cablesense_sim.kinematics import cable_jacobian_m
from cablesense_sim.replay import difference_variance_n2

VALUES = 81
"""The number of values that are tried over a range."""

_AS_GOOD = 1.001
"""The value nearest zero is taken among those that leave no more than this times the least."""


@dataclass(frozen=True)
class TensionChanges:
    """K loads hung on the straight arm one after the other, and what each changed.

    Attributes:
        name: of the table.
        load_segment: (K,) 1 to N.
        load_n: (K, 3) the load, base frame, at the segment's contact point.
        changes_n: (K, M) tensions with the load less those without.
    """

    name: str
    load_segment: NDArray[np.int64]
    load_n: Array
    changes_n: Array

    def protocol(self, joint_count: int) -> Recording:
        """(2K rows) each load hung on the unloaded arm, and taken off for the next."""
        count = len(self.load_segment)
        loaded = np.tile([0, 1], count)
        return Recording(
            name=self.name,
            time_s=np.arange(0.0, 2 * count) * 60.0,
            trial=np.repeat(np.arange(count), 2),
            command_rad=np.zeros((2 * count, joint_count)),
            load_segment=loaded * np.repeat(self.load_segment, 2),
            load_n=loaded[:, None] * np.repeat(self.load_n, 2, axis=0),
            tensions_n=np.zeros((2 * count, self.changes_n.shape[1])),
        )


class ChangeSimulator:
    """A `Simulator` whose K rows are changes under load."""

    candidates: Sequence[Candidate]
    tolerances: Sequence[Candidate]
    floor: float

    def __init__(
        self, arm: Arm, changes: TensionChanges, effects: Collection[str] | None = None
    ) -> None:
        """Candidates are those among `effects`, or all; never those that need the time."""
        self._arm = ArmSimulator(arm, changes.protocol(2 * arm.segment_count))
        self.floor = float(np.sqrt(difference_variance_n2(arm.sensors, tare_samples=1)))
        known = known_effects()
        self.candidates = tuple(
            c
            for c in self._arm.candidates
            if not known[c.effect].needs_time and (effects is None or c.effect in effects)
        )
        self.tolerances = self._arm.tolerances

    def predict(self, variants: Sequence[Assignment]) -> Array:
        """Changes (P, K, M), N, without noise; NaN where the arm finds no rest."""
        return _under_load(self._arm.predict(variants))

    def small_changes(self, base: Assignment, variants: Sequence[Assignment]) -> Array:
        """See `cablesense_gap.simulator.LinearSimulator`."""
        return _under_load(self._arm.small_changes(base, variants))


def _under_load(readings_n: Array) -> Array:
    """Changes (P, K, M) of readings (P, 2K, M), each without its load and then with it."""
    return np.asarray(readings_n[..., 1::2, :] - readings_n[..., 0::2, :])


def internal_n(arm: Arm, changes_n: Array) -> Array:
    """The part (K, M) of changes (K, M) that carries no moment on the straight arm, N.

    At rest with taut cables, J(q)ᵀ ΔT is the change of the joint moments, whatever the stiffness
    of the cables. The part in the range of J carries moments; the part orthogonal to it bends
    nothing. With three cables a segment that is one number a segment: all its cables tighter or
    slacker by the same.
    """
    straight = np.zeros(2 * arm.segment_count)
    basis, _ = np.linalg.qr(cable_jacobian_m(mechanism_of(arm), straight))
    return np.asarray(changes_n - changes_n @ basis @ basis.T)


@dataclass(frozen=True)
class OneNumber:
    """One value in one or several places, all else held.

    Attributes:
        terms: that take the value.
        low, high: its plausible range; zero, which is within it, means that nothing is different.
        held: numbers that state how the effect behaves where it is present.
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
        """The assignment that a simulator takes."""
        return {**self.held, **dict.fromkeys(self.terms, value)}


@dataclass(frozen=True)
class Scan:
    """Predictions (V, R, C) of a simulator for values (V,) over the range of one number."""

    number: OneNumber
    values: Array
    predicted: Array

    def squares(self, readings: Array) -> Array:
        """(V, R) squares that each value leaves in each row of readings (R, C)."""
        return np.asarray(((readings - self.predicted) ** 2).sum(-1))

    def rms_n(self, nominal: Array) -> Array:
        """(V,) root mean square, over all readings, by which each value changes them."""
        return np.asarray(np.sqrt(((self.predicted - nominal) ** 2).mean(axis=(1, 2))))


@dataclass(frozen=True)
class Explained:
    """How far one number explains readings.

    Attributes:
        number: which.
        value: that fits all rows best.
        rmse: the error that it leaves in them.
        held_out_rmse: that of each row under the value that fits the others best.
    """

    number: OneNumber
    value: float
    rmse: float
    held_out_rmse: float


def numbers_of(candidate: Candidate) -> Iterator[OneNumber]:
    """Every size of a candidate in every place, with every shape from which a fit should begin."""
    shapes = [p for p in candidate.parameters if p.role == "shape"]
    sizes = [p for p in candidate.parameters if p.role == "size"]
    trials = list(product(*(p.trials or p.starts or (p.default,) for p in shapes)))
    for place, size, shape in product(candidate.places, sizes, trials):
        held = dict.fromkeys(candidate.terms(place), 0.0)
        for parameter, value in zip(shapes, shape, strict=True):
            held[Term(candidate.effect, place, parameter.name)] = value
        term = Term(candidate.effect, place, size.name)
        yield OneNumber((term,), size.low, size.high, held)


def scan(simulator: Simulator, number: OneNumber) -> Scan:
    """Predict over the whole range, denser about zero, which is among the values.

    Values that cannot be simulated are left out.
    """
    even = np.linspace(-1.0, 1.0, VALUES)
    values = np.unique(np.where(even < 0.0, -number.low, number.high) * even * np.abs(even))
    predicted = simulator.predict([number.at(float(value)) for value in values])
    usable = np.isfinite(predicted).all(axis=(1, 2))
    return Scan(number, values[usable], predicted[usable])


def explain(found: Scan, readings: Array) -> Explained:
    """The value that fits best, and what values leave of rows that they were not fitted to."""
    squares = found.squares(readings)
    best = _choice(squares.sum(-1), found.values)
    held_out = np.array(
        [
            squares[_choice(np.delete(squares, row, axis=1).sum(-1), found.values), row]
            for row in range(len(readings))
        ]
    )
    return Explained(
        found.number,
        value=float(found.values[best]),
        rmse=float(np.sqrt(squares[best].sum() / readings.size)),
        held_out_rmse=float(np.sqrt(held_out.sum() / readings.size)),
    )


def _choice(squares: Array, values: Array) -> int:
    """The smallest value is chosen among those that explain equally well."""
    good = np.flatnonzero(squares <= _AS_GOOD * squares.min())
    return int(good[np.argmin(np.abs(values[good]))])
