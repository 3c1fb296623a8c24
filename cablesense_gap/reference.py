"""The residual that is expected of a healthy machine, with and without a recording of it.

In a recording of the healthy machine, the residual shows a `Discrepancy` that is expected in
others too. A hypothesis may alter it: unmodelled friction that varies along a joint's way moves
with the joint's zero, and is read with the torque's scale.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cablesense_base import Array
from cablesense_gap.coverage import Coverage, coverage_of
from cablesense_gap.diagnosis.discrepancy import (
    CORRELATED,
    Conditions,
    Discrepancy,
    Key,
    Prediction,
    ResidualByPosition,
    SmoothColumns,
    effect_columns,
)
from cablesense_gap.diagnosis.fitting import refine
from cablesense_gap.diagnosis.model_error import TwoParts
from cablesense_gap.diagnosis.problem import Hypothesis, Problem
from cablesense_gap.simulator import Assignment, Simulator, Term, predicted_changes, small_changes
from cablesense_gap.system import System, problem_of
from cablesense_gap.verdict import FittedNumber, ReferenceGap

_LEAST_COLUMN_RMS = 1e-9
"""Added to the RMS of a column, so that none is divided by zero; columns are about 1."""
_UNCOVERED_WEIGHT = 1e-6
"""Of readings that the reference does not cover: none, but for dividing by it again."""


@dataclass(frozen=True)
class MovingMean:
    """The expected residual of a healthy machine, which variants of the machine alter.

    Attributes:
        mean: (R, C) as nominal.
        usual, here: the nominal conditions, and the residual that is expected there, (R, C).
    """

    system: System
    along: ResidualByPosition
    mean: Array
    usual: Conditions
    here: Array

    def change(self, variant: Assignment) -> Array | float:
        """(R, C) by which a variant changes the mean."""
        altered = self.system.altered(variant)
        if altered is None:
            return 0.0
        altered_conditions = altered.conditions
        change = np.zeros_like(self.here)
        moves = np.flatnonzero((altered_conditions.position != self.usual.position).any(0))
        change[:, moves] = self.along.of(altered_conditions, moves) - self.here[:, moves]
        at_variant = self.mean + self.system.compared_columns(change) / self.system.scale
        return np.asarray(altered.gain * at_variant - self.mean)


@dataclass(frozen=True)
class Expected:
    """The readings that are expected of the healthy machine beyond its model.

    Attributes:
        mean: (R, C).
        weight: (R, C) ratio of the floor to the standard deviation of a reading.
        floor: root mean square of these deviations.
        moving: the change of the mean by variants; None if there is none.
        parts: scaled apart, after the weight; None if they are not.
        coverage: by the reference; readings that it does not cover have next to no weight. None
            without a reference.
    """

    mean: Array
    weight: Array
    floor: float
    moving: MovingMean | None = None
    parts: TwoParts | None = None
    coverage: Coverage | None = None

    def weighted(self, values: Array) -> Array:
        """Values (…, R, C) whose deviations are as large as the floor."""
        values = values * self.weight
        return values if self.parts is None else self.parts.scaled(values)

    def read(self, predicted: Array) -> Array:
        """Readings (R, C) as predicted, of weighted ones beyond the mean."""
        if self.parts is not None:
            predicted = self.parts.restored(predicted)
        return predicted / self.weight + self.mean


def expected_of_inexact_model(
    system: System, problem: Problem, error: Array, found: Sequence[Hypothesis]
) -> Expected:
    """The residual that is expected where the model has an unknown error, (C,) RMS.

    Most of the error is a smooth function of each channel's own position, as of springs, and of
    the direction of its motion, as of friction: waves, with the same variance in each octave. The
    rest is as large as the best of the hypotheses leaves it.
    """
    conditions = system.conditions()
    nothing = np.zeros_like(problem.readings)
    assert conditions is not None
    waves = SmoothColumns.like(conditions).waves(conditions)
    variance = np.array([1.0 / (1.0 + half_waves) for half_waves, _, _ in waves])
    columns = np.array([system.compared_columns(wave) for _, _, wave in waves])
    columns /= np.sqrt((columns**2).mean(1, keepdims=True)) + _LEAST_COLUMN_RMS
    columns *= np.sqrt(variance / variance.sum())[:, None, None] * error
    best = min(found, key=lambda each: each.held_out_rmse)
    parts, deviation = TwoParts.of(
        columns.transpose(2, 1, 0),
        problem.readings - best.held_out,
        error,
        problem.floor,
        np.where(problem.used, problem.fold[problem.trial], -1),
    )
    floor = float(np.sqrt((deviation**2).mean()))
    return Expected(nothing, nothing + floor / deviation, floor, parts=parts)


class Reference:
    """A machine as a recording shows it when healthy.

    Attributes:
        tolerances: of the machine.
        loads: that it bears beyond its model.
        left: the gap of the nominal machine there, for the verdict.
    """

    def __init__(self, system: System) -> None:
        """Take the nominal machine with the recording of when it was healthy."""
        problem = problem_of(system)
        without_effects = refine(problem, {}, [[]])
        assert without_effects is not None
        used = problem.used
        nominal = problem.readings - problem.nominal
        borne = system.borne(problem, without_effects)
        self.tolerances = dict((borne or without_effects).nuisance)
        self.loads = {} if borne is None else dict(borne.values)
        self._deviations = {} if borne is None else dict(borne.deviations)
        system = system.with_listed(self.known)
        problem = replace(
            problem,
            simulator=system,
            nominal=system.predict([{}])[0],
            nuisance_at={},
            nuisance_change=0.0 * nominal,
        )
        conditions = system.conditions()
        self._smooth = None if conditions is None else SmoothColumns.like(conditions)
        effects = _scaled_effects(system, problem)
        columns = {name: column[used] for name, column in self._columns(system, effects).items()}
        residual = (problem.readings - problem.nominal)[used]
        trial = problem.trial[used]
        discrepancy = Discrepancy(columns, residual * system.scale, problem.fold[trial])
        self._discrepancy = discrepancy
        self._by_position = None
        if self._smooth is not None and conditions is not None:
            powers = [system.compared_columns(p)[used] for p in self._smooth.powers(conditions)]
            others = {name: column[used] for name, column in effects.items()}
            self._by_position = ResidualByPosition.learnt(
                self._smooth, discrepancy, others, np.array(powers)
            )
        before = nominal[used]
        unexplained = residual - discrepancy.held_out / system.scale
        self.left = ReferenceGap(
            recording=system.recording_name,
            before_n=float(np.sqrt((before**2).mean())),
            left_n=float(np.sqrt((unexplained**2).mean())),
            channels=system.channels(before, unexplained, np.full(before.shape[1], system.floor)),
        )

    @property
    def known(self) -> dict[Term, float]:
        """Tolerances and loads: what the healthy machine has beyond its model."""
        return {**self.tolerances, **self.loads}

    def widened(
        self, numbers: Mapping[str, FittedNumber], values: Assignment
    ) -> dict[str, FittedNumber]:
        """Numbers of values; the changes of loads with the interval of what was borne before."""
        widened = dict(numbers)
        for term in values.keys() & self._deviations.keys():
            deviation = self._deviations[term]
            for name in (str(term), f"{term.effect}.{term.parameter}"):
                if name in numbers:
                    low, high = numbers[name].ci95
                    half = float(np.hypot(0.5 * (high - low), deviation))
                    middle = 0.5 * (low + high)
                    ends = middle - half, middle + half
                    widened[name] = numbers[name].model_copy(update={"ci95": ends})
        return widened

    def expected(self, system: System, problem: Problem) -> Expected:
        """In another recording, in its units; `system` has all that is `known`."""
        beyond = np.zeros_like(system.readings)
        conditions = system.conditions()
        if self._smooth is not None and conditions is not None:
            by_quantity = self._smooth.beyond(conditions)
            square = sum((each**2 for each in by_quantity), np.zeros_like(conditions.position))
            beyond = np.abs(system.compared_columns(np.sqrt(square)))
        columns = self._columns(system, _scaled_effects(system, problem))
        predicted = self._discrepancy.of(columns, beyond)
        deviation = np.maximum(predicted.deviation / system.scale, system.floor)
        coverage = self._coverage(system, predicted, conditions)
        mean = predicted.mean / system.scale
        certain = coverage.covered & system.counted[:, None]
        if not certain.any():
            certain = np.broadcast_to(system.counted[:, None], deviation.shape)
        floor = float(np.sqrt((deviation[certain] ** 2).mean()))
        # those that count have a root mean square of the floor over all rows
        all_counted = float(system.counted.sum() * deviation.shape[1])
        weight = floor / deviation * np.sqrt(all_counted / certain.sum())
        weight = np.where(certain, weight, _UNCOVERED_WEIGHT * weight)
        moving = None
        if self._by_position is not None and conditions is not None:
            mean_here = self._by_position.of(conditions, np.arange(mean.shape[1]))
            moving = MovingMean(system, self._by_position, mean, conditions, mean_here)
        return Expected(mean, weight, floor, moving, coverage=coverage)

    def _coverage(
        self, system: System, predicted: Prediction, conditions: Conditions | None
    ) -> Coverage:
        scatter = np.maximum(predicted.scatter, system.floor * system.scale)
        covered = predicted.extrapolated**2 <= CORRELATED * scatter**2
        counts = np.ones_like(system.readings)
        at_readings = conditions
        if conditions is not None:
            counts = np.abs(system.compared_columns(np.ones_like(conditions.position)))
            whole = np.maximum(counts, _LEAST_COLUMN_RMS)
            at_readings = Conditions(*(system.compared_columns(q) / whole for q in conditions))
        counts = np.minimum(counts, 1.0) * system.counted[:, None]
        return coverage_of(covered, counts, at_readings, self._smooth, system.condition_units())

    def _columns(self, system: System, effects: dict[Key, Array]) -> dict[Key, Array]:
        conditions = system.conditions()
        if self._smooth is None or conditions is None:
            return effects
        smooth = self._smooth.of(conditions)
        return effects | {key: system.compared_columns(column) for key, column in smooth.items()}


def _scaled_effects(system: System, problem: Problem) -> dict[Key, Array]:
    return {key: column * system.scale for key, column in effect_columns(problem).items()}


class _Weighted:
    """A simulator whose channels are less certain in some rows than in others."""

    def __init__(self, simulator: Simulator, expected: Expected) -> None:
        self._simulator = simulator
        self._expected = expected
        self.floor = expected.floor
        self.candidates = simulator.candidates
        self.tolerances = simulator.tolerances

    def predict(self, variants: Sequence[Assignment]) -> Array:
        """Channels (P, R, C) of P variants with the expected residual, times its weight (R, C)."""
        predicted = self._simulator.predict(variants)
        moving = self._expected.moving
        if moving is not None:
            by_variant = zip(predicted, variants, strict=True)
            predicted = np.array(
                [readings + moving.change(variant) for readings, variant in by_variant]
            )
        return self._expected.weighted(predicted)

    def small_changes(self, base: Assignment, variants: Sequence[Assignment]) -> Array:
        """Changes (P, R, C) of these by small differences from a base."""
        if self._expected.moving is not None:
            return predicted_changes(self, base, variants)
        return self._expected.weighted(small_changes(self._simulator, base, variants))


def problem_since(problem: Problem, expected: Expected) -> Problem:
    """The problem of what changed: weighted readings beyond the expected ones."""
    weighted = expected.weighted
    subsample = problem.subsample
    if subsample is not None:
        rows = subsample.rows
        part = Expected(expected.mean[rows], expected.weight[rows], expected.floor)
        subsample = replace(subsample, problem=problem_since(subsample.problem, part))
    return replace(
        problem,
        simulator=_Weighted(problem.simulator, expected),
        readings=weighted(problem.readings - expected.mean),
        nominal=weighted(problem.nominal),
        nuisance_columns=weighted(problem.nuisance_columns),
        nuisance_remainder=weighted(problem.nuisance_remainder),
        nuisance_change=weighted(problem.nuisance_change),
        past=None,
        subsample=subsample,
    )
