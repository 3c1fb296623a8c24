"""A machine with one recording of it, as the diagnosis sees it: a robot, an arm or another."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, CableSenseError
from cablesense_gap.diagnosis.discrepancy import Conditions, ConditionUnits
from cablesense_gap.diagnosis.nuisance import with_fitted_nuisance
from cablesense_gap.diagnosis.problem import Hypothesis, Past, Problem, prepare, subsampled
from cablesense_gap.explained import estimates
from cablesense_gap.kept_simulations import KeptSimulations
from cablesense_gap.simulator import Assignment, Candidate, Simulator, Term
from cablesense_gap.verdict import ChannelGap, FittedNumber, FrictionForm, Gap, Where

FOLDS = 5
"""Fits without a fold keep four fifths of the trials."""


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


class Altered(NamedTuple):
    """The change of a healthy machine's residual by a variant of the machine.

    Attributes:
        conditions: (R, C) at which the residual is then expected.
        gain: (C,) by which it is multiplied.
    """

    conditions: Conditions
    gain: Array


class System(ABC):
    """A machine under the commands and loads of one recording, as the diagnosis sees it.

    It is a `Simulator` with the recording's readings. Whoever brings another machine derives from
    it; the methods after `predict` have defaults.

    Attributes:
        name: of the nominal machine.
        recording_name: of its recording.
        recorded_row_count: of the whole recording, of which R rows are used.
        readings: (R, C) as measured.
        trial: (R,) number of each row's trial, or of its part of one.
        fold: (T,) fold of each of them, in the order of their numbers.
        counted: (R,) rows that count in fits and sizes.
        candidates: effects to choose among.
        tolerances: manufacturing tolerances; each parameter's `typical` is its standard deviation.
        floor: RMS of what the sensors add to a perfect reading.
        unit: of the channels.
        far_off: standard deviations beyond which one tolerance imitates an effect.
        scale: the factor (C,) by which readings are multiplied for units that all recordings of
            the machine share.
        compared: the compared quantities and the method, as a sentence; empty for readings.
    """

    name: str
    recording_name: str
    recorded_row_count: int
    readings: Array
    trial: NDArray[np.int64]
    fold: NDArray[np.int64]
    counted: NDArray[np.bool_]
    candidates: tuple[Candidate, ...]
    tolerances: tuple[Candidate, ...]
    floor: float
    unit: str = "N"
    far_off: float = 5.0
    scale: Array | float = 1.0
    compared: str = ""

    @abstractmethod
    def predict(self, variants: Sequence[Assignment]) -> Array:
        """Channels (P, R, C) of P variants, all with the same terms, without noise.

        NaN where the machine cannot be simulated with these numbers.
        """

    def past(self) -> Past | None:
        """By how much readings depend on the past; None if unknown."""
        return None

    def subsample(self) -> tuple[Simulator, NDArray[np.int64]] | None:
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

    def borne(self, problem: Problem, without_effects: Hypothesis) -> Hypothesis | None:
        """A load that the healthy machine bears beyond its model; None if it shows none.

        It is then part of the nominal machine, so that it may be taken off.
        """
        return None

    def conditions(self) -> Conditions | None:
        """Position, speed and load of each channel, for functions of them; None has none."""
        return None

    def condition_units(self) -> list[ConditionUnits]:
        """Name and units of each channel."""
        count = self.readings.shape[1]
        return [ConditionUnits(f"channel_{c + 1}", "", "", self.unit, "") for c in range(count)]

    def compared_columns(self, column: Array) -> Array:
        """A function of the conditions as channels are compared, (R, C)."""
        return column

    def altered(self, variant: Assignment) -> Altered | None:
        """The change of the healthy machine's residual by a variant; None if there is none."""
        return None

    def model_error(self, problem: Problem, found: Sequence[Hypothesis]) -> Array | None:
        """(C,) RMS that a model of a real machine leaves, if no hypothesis fits any channel.

        None if one does: the nominal machine is then taken to be exact but for its tolerances. A
        machine that has one has `conditions`.
        """
        return None

    def completed(self, problem: Problem, found: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The search's hypotheses, as this kind of machine weighs them."""
        return list(found)

    def where(self, values: Mapping[Term, float], residual: Array) -> Where:
        """Places of the values; regimes of the nominal residual (counted rows, C)."""
        return Where()

    def numbers(
        self, hypothesis: Hypothesis, values: Mapping[Term, float]
    ) -> dict[str, FittedNumber]:
        """The values, which are those in the places that matter, by name."""
        return estimates(values, hypothesis.deviations, self.candidates)

    def forms(self, problem: Problem, hypothesis: Hypothesis) -> dict[str, FrictionForm]:
        """By place, the law that the friction of a hypothesis follows; empty without friction."""
        return {}

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
        """Reasons, as sentences, for which a hypothesis with these values cannot be sure."""
        return ()

    def channel_groupings(self) -> Sequence[NDArray[np.int64]]:
        """Which channels may have a cause together, in one or several ways.

        Each is (C,) 0 to G - 1, the group of each channel.
        """
        return (np.arange(self.readings.shape[1]),)

    def trial_labels(self, parts: Sequence[int]) -> tuple[int | str, ...]:
        """What the recording's user knows some trials by, each once.

        `parts` are those of `trial`, counted from 0 in the order of their numbers.
        """
        numbers = np.unique(self.trial)[list(parts)]
        return tuple(numbers.tolist())

    def channels(self, before: Array, after: Array, floor: Array) -> dict[str, ChannelGap]:
        """Gaps by channel in their own units, in the order of the channels; may be empty.

        The residuals are (counted rows, C), the floors (C,), both in the units of the readings.
        """
        return {}


def problem_of(system: System, kept: KeptSimulations | None = None) -> Problem:
    """The recording as the search works on it; what is simulated is `kept` in files if given."""
    simulator: Simulator = system if kept is None else kept.simulator(system)
    problem = with_fitted_nuisance(
        prepare(simulator, system.readings, system.trial, system.fold, system.counted)
    )
    problem = replace(problem, past=system.past(), far_off=system.far_off)
    subsample = system.subsample()
    if subsample is None:
        return problem
    of_some_rows, rows = subsample
    if kept is not None:
        of_some_rows = kept.simulator(of_some_rows)
    return subsampled(problem, of_some_rows, rows)
