"""The pipeline from a system with its recording to a verdict, for arms, robots and others.

The steps are the search (`diagnosis.search`), probabilities (`diagnosis.probability`), then
shares, places, estimates and the gap (`explained`). A `System` has a method for each step that
depends on the kind of machine.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, CableSenseError
from cablesense_gap.diagnosis.discrepancy import (
    Conditions,
    Discrepancy,
    Key,
    SmoothColumns,
    effect_columns,
)
from cablesense_gap.diagnosis.fitting import refine
from cablesense_gap.diagnosis.probability import (
    ambiguity,
    bundled_calibration,
    named,
    posterior,
    rivals_of,
)
from cablesense_gap.diagnosis.problem import Explanation, Past, Problem, prepare, sketched
from cablesense_gap.diagnosis.search import search
from cablesense_gap.diagnosis.tolerances import with_fitted_tolerances
from cablesense_gap.explained import (
    candidate_results,
    estimates,
    gap_size,
    remainder,
    shares,
    significant_values,
    trades,
)
from cablesense_gap.simulator import Assignment, Candidate, Simulator, Term
from cablesense_gap.verdict import ChannelGap, FittedNumber, Gap, ReferenceGap, Verdict, Where

FOLDS = 5
"""Fits without a fold keep four fifths of the trials."""
DOUBTED = 0.5
"""The largest probability of a verdict that its numbers make doubtful."""
_MUCH_UNEXPLAINED = 0.25
"""Share of the gap from which the next experiment is to show most of the unexplained part."""


class Unlisted(NamedTuple):
    """A residual that no listed effect explains.

    Attributes:
        reasons: its pattern, as sentences.
        experiment: what to record to learn more; empty if nothing is proposed.
        correction: (R, C) by a flexible model, each trial without its fold.
    """

    reasons: tuple[str, ...]
    experiment: str
    correction: Array | float


class System(ABC):
    """A machine under the commands and loads of one recording, as the diagnosis sees it.

    It is a `Simulator` with the recording's readings. Whoever brings another machine derives from
    it; the methods after `predict` have defaults.

    Attributes:
        name: of the nominal machine.
        recording_name: of its recording.
        row_count: of the whole recording, of which R rows are used.
        readings: (R, C) as measured.
        trial: (R,) number of each row's trial, or of its part of one.
        fold: (T,) fold of each of them, in the order of their numbers.
        counted: (R,) rows that count in fits and sizes.
        candidates, tolerances, floor: see `Simulator`.
        unit: of the channels.
        scale: the factor (C,) by which readings are multiplied for units that all recordings of
            the machine share.
        compared: the compared quantities and the method, as a sentence; empty for readings.
    """

    name: str
    recording_name: str
    row_count: int
    readings: Array
    trial: NDArray[np.int64]
    fold: NDArray[np.int64]
    counted: NDArray[np.bool_]
    candidates: tuple[Candidate, ...]
    tolerances: tuple[Candidate, ...]
    floor: float
    unit: str = "N"
    scale: Array | float = 1.0
    compared: str = ""

    @abstractmethod
    def predict(self, variants: Sequence[Assignment]) -> Array:
        """Channels (P, R, C) of P variants, see `Simulator`."""

    def past(self) -> Past | None:
        """By how much readings depend on the past; None if unknown."""
        return None

    def sketch(self) -> tuple[Simulator, NDArray[np.int64]] | None:
        """A simulator of some rows alone, and these rows (K,); None if all rows are needed.

        The rows suffice to choose among history-dependent effects.
        """
        return None

    def with_listed(self, values: Assignment) -> System:
        """The same with these numbers as a part of the nominal machine.

        Raises:
            CableSenseError: this kind of machine has no diagnosis against a reference.
        """
        raise CableSenseError(f"{self.name}: this kind of machine has no reference; leave it out")

    def conditions(self) -> Conditions | None:
        """Position, speed and load of each channel, for functions of them; None has none."""
        return None

    def compared_columns(self, column: Array) -> Array:
        """A function of the conditions as channels are compared, (R, C)."""
        return column

    def model_error(self, problem: Problem, found: Sequence[Explanation]) -> Array | None:
        """(C,) RMS that a model of a real machine leaves, if no explanation fits any channel.

        None if one does: the nominal machine is then taken to be exact but for its tolerances.
        """
        return None

    def completed(self, problem: Problem, found: Sequence[Explanation]) -> list[Explanation]:
        """The search's explanations, as this kind of machine weighs them."""
        return list(found)

    def where(self, values: Mapping[Term, float], residual: Array) -> Where:
        """Places of the values; regimes of the nominal residual (counted rows, C)."""
        return Where()

    def numbers(
        self, explanation: Explanation, values: Mapping[Term, float]
    ) -> dict[str, FittedNumber]:
        """The values, which are those in the places that matter, by name."""
        return estimates(values, explanation.deviations, self.candidates)

    def next_experiment(self, rivals: Sequence[Assignment], question: str) -> str:
        """The recording that distinguishes the first rival from the others.

        A single rival is distinguished from the nominal machine.
        """
        return ""

    def repetition(self, residual: Array) -> str:
        """How to repeat and vary the trial with the largest residual (counted rows, C).

        Empty if this kind of machine has nothing to propose.
        """
        return ""

    def unlisted(self, problem: Problem, residual: Array) -> Unlisted:
        """The pattern of a held-out residual (R, C) that no listed effect explains."""
        return Unlisted((), "", 0.0)

    def doubts(self, values: Mapping[Term, float], gap: Gap) -> tuple[str, ...]:
        """Reasons, as sentences, for which an explanation with these values cannot be sure."""
        return ()

    def channels(self, before: Array, after: Array) -> dict[str, ChannelGap]:
        """Gaps by channel in their own units, of residuals (counted rows, C); may be empty."""
        return {}


@dataclass(frozen=True)
class Outcome:
    """A verdict and the fit behind it.

    Attributes:
        values: of the named effects in the places that matter.
        tolerances: as fitted.
        nominal: (R, C) predicted by the nominal machine.
        held_out: (R, C) by the amended machine, or with the flexible correction, each trial
            without its fold.
    """

    verdict: Verdict
    values: dict[Term, float]
    tolerances: Mapping[Term, float]
    nominal: Array
    held_out: Array


@dataclass(frozen=True)
class Expected:
    """The readings that are expected of the healthy machine beyond its model.

    Attributes:
        mean: (R, C).
        weight: (R, C) ratio of the floor to the standard deviation of a reading.
        floor: root mean square of these deviations.
    """

    mean: Array
    weight: Array
    floor: float

    def read(self, predicted: Array) -> Array:
        """Readings (R, C) as predicted, of weighted ones beyond the mean."""
        return predicted / self.weight + self.mean


def problem_of(system: System) -> Problem:
    """The recording as the search works on it."""
    problem = with_fitted_tolerances(
        prepare(system, system.readings, system.trial, system.fold, system.counted)
    )
    problem, sketch = replace(problem, past=system.past()), system.sketch()
    return problem if sketch is None else sketched(problem, *sketch)


class Reference:
    """A machine as a recording shows it when healthy.

    Attributes:
        tolerances: of the machine.
        left: the gap of the nominal machine there, for the verdict.
    """

    def __init__(self, system: System) -> None:
        """`system` is the nominal machine with the reference."""
        problem = problem_of(system)
        none = refine(problem, {}, [[]])
        assert none is not None
        used, nominal = problem.used, problem.readings - problem.nominal
        self.tolerances = dict(none.tolerances)
        system = system.with_listed(self.tolerances)
        problem = replace(problem, simulator=system, nominal=system.predict([{}])[0])
        conditions = system.conditions()
        self._smooth = None if conditions is None else SmoothColumns.like(conditions)
        columns = {name: column[used] for name, column in self._columns(system, problem).items()}
        residual, trial = (problem.readings - problem.nominal)[used], problem.trial[used]
        found = Discrepancy(columns, residual * system.scale, problem.fold[trial])
        self._discrepancy = found
        before, left = nominal[used], residual - found.held_out / system.scale
        self.left = ReferenceGap(
            recording=system.recording_name,
            before_n=float(np.sqrt((before**2).mean())),
            left_n=float(np.sqrt((left**2).mean())),
            channels=system.channels(before, left),
        )

    def expected(self, system: System, problem: Problem) -> Expected:
        """In another recording, in its units; `system` has the reference's tolerances."""
        beyond, conditions = np.zeros_like(system.readings), system.conditions()
        if self._smooth is not None and conditions is not None:
            beyond = np.abs(system.compared_columns(self._smooth.beyond(conditions)))
        mean, deviation = self._discrepancy.of(self._columns(system, problem), beyond)
        deviation = np.maximum(deviation / system.scale, system.floor)
        floor = float(np.sqrt((deviation[system.counted] ** 2).mean()))
        return Expected(mean / system.scale, floor / deviation, floor)

    def _columns(self, system: System, problem: Problem) -> dict[Key, Array]:
        columns = {name: own * system.scale for name, own in effect_columns(problem).items()}
        conditions = system.conditions()
        if self._smooth is not None and conditions is not None:
            smooth = self._smooth.of(conditions)
            columns |= {name: system.compared_columns(own) for name, own in smooth.items()}
        return columns


class _Weighted:
    """A simulator whose channels are less certain in some rows than in others."""

    def __init__(self, simulator: Simulator, weight: Array, floor: float) -> None:
        self._simulator, self._weight, self.floor = simulator, weight, floor
        self.candidates, self.tolerances = simulator.candidates, simulator.tolerances

    def predict(self, variants: Sequence[Assignment]) -> Array:
        """As of the simulator, times the weight (R, C)."""
        return self._simulator.predict(variants) * self._weight


def _since(problem: Problem, expected: Expected) -> Problem:
    """The problem of what changed: weighted readings beyond the expected ones."""
    weight, sketch = expected.weight, problem.sketch
    if sketch is not None:
        part = replace(expected, mean=expected.mean[sketch.rows], weight=weight[sketch.rows])
        sketch = replace(sketch, problem=_since(sketch.problem, part))
    return replace(
        problem,
        simulator=_Weighted(problem.simulator, weight, expected.floor),
        readings=(problem.readings - expected.mean) * weight,
        nominal=problem.nominal * weight,
        tolerance_columns=problem.tolerance_columns * weight,
        tolerance_rest=problem.tolerance_rest * weight,
        past=None,
        sketch=sketch,
    )


def diagnose_system(
    system: System,
    progress: Callable[[str, float], None] = lambda *_: None,
    workers: int = 1,
    began_s: float | None = None,
    reference: Reference | None = None,
) -> Outcome:
    """Find what makes the recorded machine differ from the nominal one.

    `progress` receives the present step and the share that is done; `began_s` is when the
    diagnosis started, by `time.monotonic`. With a `reference`, whose tolerances the system has,
    it is what changed since then.
    """
    began_s = time.monotonic() if began_s is None else began_s
    problem, calibration = problem_of(system), bundled_calibration()
    nothing = np.zeros_like(problem.readings)
    usual = Expected(nothing, nothing + 1.0, problem.floor)
    if reference is not None:
        usual = reference.expected(system, problem)
        problem = _since(problem, usual)
    found = system.completed(problem, search(problem, progress, workers))
    error = None if reference is not None else system.model_error(problem, found)
    if error is not None:
        deviation = np.hypot(problem.floor, error)
        floor = float(np.sqrt((deviation**2).mean()))
        usual = Expected(nothing, nothing + floor / deviation, floor)
        problem = _since(problem, usual)
        found = system.completed(problem, search(problem, progress, workers))
    ranked = named(problem, posterior(found, problem.floor, calibration), calibration)
    progress("describing the verdict", 0.98)
    best, used = ranked[0].explanation, problem.used
    fitted = [r.explanation for r in ranked if r.explanation is not None]
    none = next(e for e in fitted if not e.effects)
    explained = best or none
    values = significant_values(explained, system.candidates)
    traded = trades(problem, best) if best else []
    rest = remainder(problem, explained)
    group, reasons = ambiguity(problem, ranked, system.unit)
    held_out, experiment = explained.held_out, ""
    if best:
        rivals = [r.explanation.values for r in rivals_of(ranked) if r.explanation is not None]
        if traded and not rivals:
            one, other = (e.replace("_", " ") for e in traded[0].traded.effects)
            question = f"how much is {one} and how much {other}"
            experiment = system.next_experiment([best.values, traded[0].elsewhere], question)
        elif rest.share >= _MUCH_UNEXPLAINED and not rivals:
            experiment = system.repetition((system.readings - usual.read(best.held_out))[used])
        experiment = experiment or system.next_experiment([values, *rivals], "")
    else:
        described = system.unlisted(problem, problem.readings - none.held_out)
        least = min(fitted, key=lambda e: e.held_out_rmse)
        names = " with ".join(least.effects).replace("_", " ") or "none"
        left = (
            f"On held-out trials, tolerances alone leave {none.held_out_rmse:.3g} {system.unit}; "
            f"the best that listed effects do is {least.held_out_rmse:.3g} {system.unit} "
            f"({names})."
        )
        reasons = (left, *described.reasons)
        experiment = described.experiment
        held_out = none.held_out + described.correction
    before, after = ((problem.readings - each)[used] for each in (problem.nominal, held_out))
    nominal, held_out = (usual.read(each) for each in (problem.nominal, held_out))
    measured = [(system.readings - each)[used] for each in (nominal, held_out)]
    alone = problem.readings - best.held_out_effects if best and best.effects else None
    gap = gap_size(
        before, after, problem.trial[used], problem.floor, None if alone is None else alone[used]
    )
    doubts = system.doubts(values, gap) if values else ()
    if error is not None:
        inexact = (
            "No explanation fits any channel. The model is taken to leave "
            f"{problem.floor:.3g} {system.unit}, as models of real machines do, and the verdict "
            "is what stands out of that. A reference, recorded when the machine was healthy, "
            "would show more.",
        )
        doubts, reasons = (inexact + doubts, reasons) if values else (doubts, inexact + reasons)
    if doubts:
        sure = min(ranked[0].probability, DOUBTED)
        ranked = [replace(ranked[0], probability=sure), *ranked[1:]]
    verdict = Verdict(
        effects=ranked[0].effects,
        probability=ranked[0].probability,
        ambiguity_group=group,
        next_experiment=experiment,
        where=system.where(values, measured[0]),
        parameters=system.numbers(explained, values),
        shares=shares(problem, ranked, values),
        traded=tuple(trade.traded for trade in traded),
        tolerances_n=rest.tolerances,
        unexplained_n=rest.unexplained,
        unexplained_share=rest.share,
        gap=gap,
        doubts=doubts,
        reference=None if reference is None else reference.left,
        candidates=candidate_results(ranked),
        why=reasons,
        seconds=time.monotonic() - began_s,
        recording=system.recording_name,
        rows=system.row_count,
        rows_used=len(problem.trial),
        rows_counted=int(used.sum()),
        arm=system.name,
        unit=system.unit,
        channels=system.channels(*measured),
        compared=system.compared,
    )
    progress("done", 1.0)
    return Outcome(verdict, values, explained.tolerances, nominal, held_out)
