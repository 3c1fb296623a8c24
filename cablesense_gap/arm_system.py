"""The cable-driven arm as a `System`, and its diagnosis from a recording to an amended arm."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.amended_arm import amended_arm, judged_earlier, listed_values, without_effects
from cablesense_gap.arm_nuisance import FittedParameters, fitted_parameters
from cablesense_gap.arm_simulator import ArmSimulator, counted_rows, supported_rows
from cablesense_gap.diagnosis.discrepancy import Conditions, ConditionUnits
from cablesense_gap.diagnosis.problem import Hypothesis, Past, Problem, unit_of
from cablesense_gap.experiments import next_experiment
from cablesense_gap.kept_simulations import KeptSimulations
from cablesense_gap.pipeline import diagnose_system
from cablesense_gap.reference import Reference
from cablesense_gap.residuals import decompose, regimes
from cablesense_gap.simulator import Assignment, Simulator, Term
from cablesense_gap.system import FOLDS, System, Unlisted, problem_of
from cablesense_gap.unlisted import describe_unlisted, in_play, repeat_largest_trial
from cablesense_gap.verdict import UNKNOWN, ChannelGap, Earlier, FittedNumber, Verdict, Where
from cablesense_recording.checks import check_recording
from cablesense_recording.recording import (
    EXCHANGED,
    Finding,
    Recording,
    refuse_unusable,
    returns,
    rows_along_path,
    rows_to_use,
    warn,
)
from cablesense_sim.arm import Arm, ArmFileError
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import known_effects, transmissions
from cablesense_sim.equilibrium import held_lengths_m
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.replay import reading_variance_n2, replay_arm

_LEAST_SUPPORTED = 0.9
"""Share of the rows in which the nominal arm must have an equilibrium; the others are left out.
Real arms bear loads near the nominal arm's limit. Loads in a wrong unit fail in most rows."""
_PLAY_SHARE = 0.03
"""Share of a cable's way after which it slides the other way, as seen by the reference."""
_SUBSAMPLE_SHARE = 0.7
"""A subsample with more than this share of the rows saves too little time."""


class ArmSystem(ArmSimulator, System):
    """An arm with a recording of it.

    Rows do not count where the arm's equilibrium is not unique, or about to turn (`counted_rows`),
    and those of the trials `unseen` do not.
    """

    def __init__(
        self,
        arm: Arm,
        recording: Recording,
        unseen: Collection[int] = (),
        recorded_row_count: int | None = None,
    ) -> None:
        """`recording` holds the rows to use; `unseen` are numbers of trials.

        `recorded_row_count` is that of the whole recording, by default of the rows to use.
        """
        super().__init__(arm, recording)
        self.name = arm.name
        self.recording_name = recording.name
        self.recorded_row_count = recorded_row_count or len(recording)
        self.recording = recording
        self._unseen = tuple(unseen)
        self.readings = recording.tensions_n
        self.trial, self.fold = parts_of(recording, unseen)
        self.nominal_n = self.predict([{}])[0]
        self.counted = np.zeros(len(recording), dtype=bool)
        if np.isfinite(self.nominal_n).all():
            self.counted = counted_rows(arm, recording, self.nominal_n)
            self.counted &= ~np.isin(recording.trial, list(unseen))

    @property
    def _counted_recording(self) -> Recording:
        return self.recording.rows(self.counted)

    def with_listed(self, values: Assignment) -> ArmSystem:
        """The same arm with these values listed behind the effects of its file."""
        listing = amended_arm(self.arm, {}, values)
        return ArmSystem(listing, self.recording, self._unseen, self.recorded_row_count)

    def conditions(self) -> Conditions:
        """Lengths of cable, the direction in which cable slides, and nominal tensions."""
        mechanism = mechanism_of(self.arm)
        held_m = held_lengths_m(mechanism, self.recording.command_rad)
        stretched_m = self.nominal_n / mechanism.cable_stiffness_n_m
        way = in_play(held_m - stretched_m, _PLAY_SHARE)
        return Conditions(held_m, way, self.nominal_n, np.zeros_like(held_m))

    def condition_units(self) -> list[ConditionUnits]:
        """Of each cable."""
        return [ConditionUnits(name, "m", "", "N", "") for name in self.arm.cable_names]

    def past(self) -> Past | None:
        """By how much readings differ where commands and loads return, and in which rows.

        None where they return too seldom, and if the nominal arm depends on the past.
        """
        if transmissions([entries_of(self.arm)]):
            return None
        if (returned := returns(self._counted_recording, self.floor)) is None:
            return None
        rows = np.zeros(len(self.recording), dtype=bool)
        rows[self.counted] = returned[1]
        return Past(returned[0], rows)

    def subsample(self) -> tuple[Simulator, NDArray[np.int64]] | None:
        """The arm at rows along the path of commands and loads, and these rows (K,)."""
        rows = rows_along_path(self.recording)
        if len(rows) > _SUBSAMPLE_SHARE * len(self.recording):
            return None
        return ArmSimulator(self.arm, self.recording.rows(rows)), rows

    def where(self, values: Mapping[Term, float], residual: Array) -> Where:
        """Cables, segments and joints of the values, and regimes of the residual."""
        parts = decompose(self._counted_recording, residual, self.floor, self.arm)
        return places_of(values, tuple(regimes(parts)))

    def numbers(
        self, hypothesis: Hypothesis, values: Mapping[Term, float]
    ) -> dict[str, FittedNumber]:
        """The values, and products of which readings may show more than of their factors."""
        fitted_numbers = super().numbers(hypothesis, values)
        for name, place in dict.fromkeys(term[:2] for term in values):
            if known_effects()[name].product is not None:
                fitted_numbers = with_product(
                    fitted_numbers, hypothesis, name, place, mechanism_of(self.arm)
                )
        return fitted_numbers

    def trial_labels(self, parts: Sequence[int]) -> tuple[int, ...]:
        """The recording's numbers, the lowest first; a long trial has several parts."""
        numbers = np.unique(self.recording.trial[np.isin(self.trial, parts)])
        return tuple(numbers.tolist())

    def channel_groupings(self) -> Sequence[NDArray[np.int64]]:
        """Each cable by itself, and the cables that end on a segment."""
        return (np.arange(self.arm.cable_count), mechanism_of(self.arm).cable_segment - 1)

    def channels(self, before: Array, after: Array, floor: Array) -> dict[str, ChannelGap]:
        """The gap in each cable."""
        sizes_n = [np.sqrt((each**2).mean(0)) for each in (before, after)]
        columns = zip(self.arm.cable_names, *sizes_n, floor, strict=True)
        return {
            name: ChannelGap(unit="N", before=float(b), after=float(a), floor=float(floor_n))
            for name, b, a, floor_n in columns
        }

    def next_experiment(self, rivals: Sequence[Assignment], question: str) -> str:
        """The block of the standard protocol that shows how the rivals differ, as text."""
        return next_experiment(self.arm, rivals, self.floor, question=question).text

    def repetition(self, residual: Array) -> str:
        """The load or motion of the trial with the largest residual, and how to vary it."""
        return repeat_largest_trial(self._counted_recording, residual, self.floor)

    def unlisted(self, problem: Problem, residual: Array) -> Unlisted:
        """Its pattern over cables, loads and time, and a flexible model of it."""
        return describe_unlisted(problem, residual, self.recording, self.arm, self.conditions())


def with_product(
    numbers: Mapping[str, FittedNumber],
    hypothesis: Hypothesis,
    name: str,
    place: str,
    mechanism: Mechanism,
) -> dict[str, FittedNumber]:
    """The numbers with the product of an effect at a place, which is `Effect.product`.

    A size that is known poorly gets the interval of the product over the lever. One that is linear
    about the fit would reach beyond zero, and miss sizes with another lever.
    """
    effect = known_effects()[name]
    assert effect.product is not None
    size, shape = effect.parameters
    terms = [Term(name, place, p.name) for p in effect.parameters]
    term_indices = [list(hypothesis.values).index(term) for term in terms]
    amount, form = (hypothesis.values[term] for term in terms)

    def lever(of_form: float) -> float:
        return effect.lever(mechanism, place, {shape.name: of_form})

    slope = np.array([lever(form), amount * (lever(form + 1.0) - lever(form))])
    slope *= [unit_of(size, amount), unit_of(shape, form)]
    variance = float(slope @ hypothesis.covariance[np.ix_(term_indices, term_indices)] @ slope)
    half = 1.96 * max(variance, 0.0) ** 0.5
    value = amount * lever(form)
    prefix = name
    if f"{prefix}.{size.name}" not in numbers:
        prefix = f"{name}.{place}"
    product = FittedNumber(
        value=value, unit=effect.product.unit, ci95=(value - half, value + half)
    )
    completed_numbers = {f"{prefix}.{effect.product.name}": product, **numbers}
    of_size = f"{prefix}.{size.name}"
    low, high = numbers[of_size].ci95
    if high - low > abs(amount):
        short, long = map(lever, numbers[f"{prefix}.{shape.name}"].ci95)
        ends = max(abs(value) - half, 0.0) / long, (abs(value) + half) / max(short, 1e-9)
        low, high = np.clip(np.sort(np.sign(value) * np.array(ends)), size.low, size.high).tolist()
        completed_numbers[of_size] = numbers[of_size].model_copy(update={"ci95": (low, high)})
    return completed_numbers


@dataclass(frozen=True)
class Diagnosis:
    """A verdict, the arm that follows from it, and what both arms predict.

    Attributes:
        recording: the R rows that were used (`rows_to_use`).
        amended: the arm with the effects and tolerances that were found.
        predicted_n: (R, M) by the nominal arm.
        held_out_n: (R, M) by the amended arm, each trial with effects fitted without its fold.
        counted: (R,) rows that count in sizes of the gap (`counted_rows`).
        parameters: what the recording says about the arm's uncertain parameters, beside the
            effects that were found.
        notes: what was read of the recording, as sentences.
        warnings: what its checks found, as sentences.
    """

    recording: Recording
    nominal: Arm
    verdict: Verdict
    amended: Arm
    predicted_n: Array
    held_out_n: Array
    counted: NDArray[np.bool_]
    parameters: FittedParameters
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def before_n(self) -> Array:
        """Residual (R, M) of the nominal arm, measured minus predicted; NaN where none counts."""
        return self._residual_n(self.predicted_n)

    @property
    def after_n(self) -> Array:
        """Residual (R, M) of the amended arm on held-out trials; NaN where none counts."""
        return self._residual_n(self.held_out_n)

    def _residual_n(self, predicted_n: Array) -> Array:
        return np.where(self.counted[:, None], self.recording.tensions_n - predicted_n, np.nan)

    @property
    def after_label(self) -> str:
        """The name of the state after in pictures; empty if nothing was changed."""
        if np.allclose(self.before_n, self.after_n, equal_nan=True):
            return ""
        return "flexible correction" if self.verdict.effects == (UNKNOWN,) else "amended arm"


def diagnose(
    recording: Recording,
    arm: Arm,
    progress: Callable[[str, float], None] = lambda *_: None,
    workers: int = 1,
    on_finding: Callable[[str], None] = lambda _: None,
    unseen: Collection[int] = (),
    reference: Recording | None = None,
    *,
    force: bool = False,
    announce: Callable[[float], None] = lambda _: None,
    kept: KeptSimulations | None = None,
) -> Diagnosis:
    """Find what makes the recorded arm differ from the nominal one.

    Effects that the arm file lists are judged first. The diagnosis starts from those that are
    still needed, with the numbers that this recording gives them.

    Args:
        recording: of the arm, as `read_recording` gives it.
        arm: the nominal one.
        progress: receives the present step and the share of the whole that is done.
        workers: processes that share the search.
        on_finding: receives each problem of the recording before the search starts.
        unseen: numbers of trials whose readings are only checked; neither the search nor any
            figure of the verdict uses them.
        reference: of the same arm when it was healthy; the verdict says what changed since.
        force: whether to continue if channels look exchanged; the warnings then say so.
        announce: receives the seconds that the search will take, before it begins.
        kept: files from which a diagnosis goes on that was interrupted.

    Raises:
        RecordingError: the recording or the reference cannot be used, or channels look exchanged.
        ArmFileError: the arm's sensors are perfect.
        EquilibriumError: the nominal arm has no static equilibrium in too many rows, or depends
            on history and has none in one.
    """
    began_s = time.monotonic()
    if reading_variance_n2(arm.sensors) == 0.0:
        raise ArmFileError(
            f"{arm.identity}: noise_std_n and step_n of its sensors are both 0; a gap is judged "
            "by what the sensors add to a reading, so one of them must be above 0"
        )
    refuse_unusable(recording, check_recording(recording, arm))
    progress("predicting the nominal arm", 0.0)
    earlier: tuple[Earlier, ...] = ()
    if listed_values(arm):
        progress("judging what the arm file lists", 0.0)
        rows = rows_to_use(recording)
        bare = ArmSystem(without_effects(arm), recording.rows(rows), unseen)
        if np.isfinite(bare.nominal_n).all():  # else the arm needs its effects to be supported
            bare_findings = check_recording(recording, bare.arm, bare.nominal_n, rows)
            exchanged = [finding for finding in bare_findings if finding.kind == EXCHANGED]
            refuse_unusable(recording, exchanged, force=force)
            arm, earlier = judged_earlier(problem_of(bare), arm)
    healthy = None
    if reference is not None:
        progress("fitting the reference", 0.0)
        healthy = Reference(_checked_system(arm, reference, (), force=force)[0])
        arm = amended_arm(arm, {}, healthy.tolerances)
    system, findings = _checked_system(arm, recording, unseen, force=force)
    for finding in findings:
        on_finding(finding.text)
    outcome = diagnose_system(system, progress, workers, began_s, healthy, announce, kept)
    amended = amended_arm(arm, outcome.values, outcome.tolerances)
    return Diagnosis(
        recording=system.recording,
        nominal=arm,
        verdict=outcome.verdict.model_copy(update={"earlier": earlier}),
        amended=amended,
        predicted_n=outcome.nominal,
        held_out_n=outcome.held_out,
        counted=system.counted,
        parameters=fitted_parameters(arm, amended, outcome.known),
        notes=recording.notes,
        warnings=tuple(finding.text for finding in findings),
    )


def _checked_system(
    arm: Arm, recording: Recording, unseen: Collection[int], *, force: bool
) -> tuple[ArmSystem, list[Finding]]:
    """The system of a recording that can be used, and what its checks found.

    A few rows in which the arm has no equilibrium are left out.
    """
    refuse_unusable(recording, check_recording(recording, arm))
    rows = rows_to_use(recording)
    system = ArmSystem(arm, recording.rows(rows), unseen, len(recording))
    unsupported = np.zeros(len(recording), dtype=bool)
    if not np.isfinite(system.nominal_n).all():
        used = system.recording
        supported = supported_rows(arm, used)
        if supported.all() or supported.mean() < _LEAST_SUPPORTED:
            # raises with a row that has no equilibrium
            replay_arm(arm, used.course)
        unsupported[rows[~supported]] = True
        rows = rows[supported]
        system = ArmSystem(arm, recording.rows(rows), unseen, len(recording))
    findings = check_recording(recording, arm, system.nominal_n, rows)
    refuse_unusable(recording, findings, force=force)
    if unsupported.any():
        text = (
            f"{recording.where(unsupported)}: {arm.name} as its file describes it finds no rest "
            "under the recorded loads, though the real arm did; left out. Check the scale of the "
            "loads, or load the arm less"
        )
        findings.append(warn("unborne", text))
    return system, findings


def folds_of(recording: Recording, unseen: Collection[int] = ()) -> NDArray[np.int64]:
    """(T,) fold 0 to 4 of each trial, in the order of their numbers.

    Trials of one kind are dealt to the folds in turn, so that each fold leaves some of every kind
    to fit to. A kind is the loaded segment, the place of the load on it, and whether the arm
    moves. Those `unseen` are dealt separately.
    """
    kinds: dict[tuple[bool, int, float, bool], list[int]] = {}
    places_m = recording.course.places_m
    at_m = np.zeros(len(recording)) if places_m is None else np.nan_to_num(places_m).max(axis=1)
    for t, number in enumerate(np.unique(recording.trial)):
        rows = recording.trial == number
        moves = bool((np.ptp(recording.command_rad[rows], axis=0) > 0.0).any())
        segment = int(recording.load_segment[rows].max())
        kind = number in unseen, segment, float(at_m[rows].max()), moves
        kinds.setdefault(kind, []).append(t)
    dealt = [t for kind in sorted(kinds) for t in kinds[kind]]
    fold = np.empty(len(dealt), dtype=np.int64)
    fold[dealt] = np.arange(len(dealt)) % min(FOLDS, len(dealt))
    return fold


def parts_of(
    recording: Recording, unseen: Collection[int] = ()
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(R,) part of each row and (T,) fold of each part: trials, cut where they are long.

    A trial with more than a fold's share of the rows is often the only motion through all poses.
    Fits without it would have to extrapolate to it, which on a stiff arm fails by far more than
    an effect changes: each fold gets a part of it.
    """
    part = np.unique(recording.trial, return_inverse=True)[1]
    fold = folds_of(recording, unseen)
    for t, count in enumerate(np.bincount(part)):
        if count > max(len(part) / FOLDS, FOLDS):
            for k, rows in enumerate(np.array_split(np.flatnonzero(part == t), FOLDS)[1:], 1):
                part[rows] = len(fold)
                fold = np.append(fold, (fold[t] + k) % FOLDS)
    return part, fold


def places_of(values: Mapping[Term, float], regimes: tuple[str, ...]) -> Where:
    """The places by kind; an effect of the whole arm names none, crosstalk its source channel."""
    places = " ".join(term.place.split("_into_")[0] for term in values)

    def of_kind(kind: str) -> tuple[str, ...]:
        numbers = sorted({int(number) for number in re.findall(rf"{kind}_(\d+)", places)})
        return tuple(f"{kind}_{n}" for n in numbers)

    return Where(
        cables=of_kind("cable"),
        segments=of_kind("segment"),
        joints=of_kind("joint"),
        regimes=regimes,
    )
