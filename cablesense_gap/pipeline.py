"""From a recording and a nominal arm to a verdict.

The way of a recording, from here downward: checks (`recordings.checks`), the rows to use
(`recordings.thinning`), the nominal arm and the candidates (`arm_simulator`), screening and fits
(`diagnosis.search`), probabilities (`diagnosis.probability`), then the places, numbers and gap of
the verdict.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.arm_simulator import ArmSimulator, amended_arm, borne_rows, counted_rows
from cablesense_gap.budget import rest_of, shares, trades
from cablesense_gap.diagnosis.probability import (
    Ranked,
    ambiguity,
    bundled_calibration,
    named,
    posterior,
    rivals_of,
)
from cablesense_gap.diagnosis.problem import (
    Explanation,
    Problem,
    prepare,
    sketched,
    to_scaled,
)
from cablesense_gap.diagnosis.search import search
from cablesense_gap.earlier import GoingOn, going_on, listed_values, without_effects
from cablesense_gap.experiments import next_experiment
from cablesense_gap.recordings.channels import stiffness_findings, unborne_findings
from cablesense_gap.recordings.checks import check_recording, refuse_unusable
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.recordings.thinning import rows_along_path, rows_to_use
from cablesense_gap.residuals import decompose, regimes
from cablesense_gap.simulator import Candidate, Term, parameters_of
from cablesense_gap.unlisted import describe_unlisted, repeat_largest_trial
from cablesense_gap.verdict import (
    UNKNOWN,
    CandidateResult,
    Earlier,
    FittedNumber,
    Gap,
    Verdict,
    Where,
    removed_fraction,
)
from cablesense_sim.arm import Arm, ArmFileError
from cablesense_sim.replay import reading_variance_n2, replay_arm

FOLDS = 5
NEGLIGIBLE = 0.1
"""A place that changes the readings by less than this share of the foremost one is not named."""
_MUCH_UNEXPLAINED = 0.25
"""Of the gap: the next experiment is then the one that shows most of it."""
_DRAWS = 2000
_LEAST_BORNE = 0.98
"""Of the rows: so few others, in which the nominal arm finds no rest, are left out."""
_SKETCH_SHARE = 0.7
"""Of the rows, at most, that a search among effects that depend on the past goes through first."""


@dataclass(frozen=True)
class Diagnosis:
    """A verdict, the arm that follows from it, and what both arms predict.

    Attributes:
        recording: the R rows that were used (`recordings.thinning`).
        amended: the arm with what was found.
        predicted_before_n: (R, M) by the nominal arm.
        predicted_after_n: (R, M) by the amended arm.
        held_out_n: (R, M) by the amended arm, each trial fitted without its fold; NaN where none.
        counted: (R,) rows that count in sizes of the gap (`counted_rows`).
        findings: of the checks of the recording, as sentences.
    """

    recording: Recording
    nominal: Arm
    verdict: Verdict
    amended: Arm
    predicted_before_n: Array
    predicted_after_n: Array
    held_out_n: Array
    counted: NDArray[np.bool_]
    findings: tuple[str, ...] = ()

    @property
    def before_n(self) -> Array:
        """Residual (R, M) of the nominal arm, measured less predicted; NaN where none counts."""
        return self._residual_n(self.predicted_before_n)

    @property
    def after_n(self) -> Array:
        """Residual (R, M) of the amended arm on held-out trials; NaN where none counts."""
        return self._residual_n(self.held_out_n)

    def _residual_n(self, predicted_n: Array) -> Array:
        return np.where(self.counted[:, None], self.recording.tensions_n - predicted_n, np.nan)

    @property
    def after_label(self) -> str:
        """What pictures call the state after; empty where nothing was changed."""
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
) -> Diagnosis:
    """Find what makes the recorded arm differ from the nominal one.

    `progress` is called with what is under way and which share of the whole is done, `on_finding`
    with each problem of the recording before the search begins. The readings of the trials
    `unseen` are only checked: neither the search nor any figure of the verdict has them.

    Of effects that the arm file lists it is said what of them stands, and the diagnosis goes on
    from these, with the numbers that this recording gives them (`earlier`).

    Raises:
        RecordingError: the recording cannot be used.
        ArmFileError: the arm's sensors are perfect.
        EquilibriumError: the nominal arm has no static equilibrium in too many rows, or depends
            on history and has none in one.
    """
    began = time.monotonic()
    if reading_variance_n2(arm.sensors) == 0.0:
        raise ArmFileError(
            f"{arm.identity}: noise_std_n and step_n of its sensors are both 0; a gap is judged "
            "by what the sensors add to a reading, so one of them must be above 0"
        )
    whole = recording
    refuse_unusable(whole, check_recording(whole, arm))
    rows = rows_to_use(whole)
    recording = whole if len(rows) == len(whole) else whole.rows(rows)
    progress("predicting the nominal arm", 0.0)
    earlier: tuple[Earlier, ...] = ()
    if listed_values(arm):
        progress("judging what the arm file lists", 0.0)
        arm, earlier = _going_on(arm, recording, unseen)
    simulator = ArmSimulator(arm, recording)
    nominal = simulator.predict([{}])[0]
    unborne = np.zeros(len(whole), dtype=bool)
    if not np.isfinite(nominal).all():
        borne = borne_rows(arm, recording)
        if borne.all() or borne.mean() < _LEAST_BORNE:  # raises with a row that cannot be borne
            replay_arm(arm, recording.time_s, recording.command_rad, recording.forces_n)
        unborne[rows[~borne]] = True
        recording, rows = recording.rows(np.flatnonzero(borne)), rows[borne]
        simulator = ArmSimulator(arm, recording)
        nominal = simulator.predict([{}])[0]
    findings = check_recording(whole, arm, nominal, rows)
    refuse_unusable(whole, findings)
    findings += stiffness_findings(recording, arm, nominal)
    findings += unborne_findings(unborne, arm)
    for finding in findings:
        on_finding(finding.text)
    problem = problem_of(recording, simulator, nominal, unseen)
    calibration = bundled_calibration()
    found = posterior(search(problem, progress, workers), problem.floor, calibration)
    ranked = named(problem, found, calibration)
    progress("describing the verdict", 0.98)
    best = ranked[0].explanation
    fitted = [r.explanation for r in ranked if r.explanation is not None]
    none = next(h for h in fitted if not h.effects)
    explained = best or none
    values = foremost(explained, simulator.candidates)
    used, before = problem.used, recording.tensions_n - nominal
    group, reasons = ambiguity(problem, ranked)
    rest = rest_of(problem, explained)
    traded = trades(problem, best) if best else []
    if best:
        rivals = [r.explanation.values for r in rivals_of(ranked) if r.explanation is not None]
        if traded and not rivals:
            one, other = (e.replace("_", " ") for e in traded[0].traded.effects)
            question = f"how much is {one} and how much {other}"
            parted = [best.values, traded[0].elsewhere]
            experiment = next_experiment(arm, parted, problem.floor, question=question).text
        elif rest.share >= _MUCH_UNEXPLAINED and not rivals:
            left = (recording.tensions_n - best.held_out)[used]
            experiment = repeat_largest_trial(recording.rows(used), left, problem.floor)
        else:
            experiment = next_experiment(arm, [values, *rivals], problem.floor).text
        held_out, predicted = explained.held_out, explained.prediction
    else:
        reasons, experiment, held_out = describe_unlisted(problem, recording, fitted, arm)
        predicted = held_out
    parts = decompose(recording.rows(used), before[used], problem.floor, arm)
    after = recording.tensions_n - held_out
    alone = recording.tensions_n - best.held_out_effects if best and best.effects else None
    verdict = Verdict(
        effects=ranked[0].effects,
        probability=ranked[0].probability,
        ambiguity_group=group,
        next_experiment=experiment,
        where=where(values, tuple(regimes(parts))),
        parameters=estimates(values, explained.deviations, simulator.candidates),
        shares=shares(problem, ranked, values),
        traded=tuple(trade.traded for trade in traded),
        earlier=earlier,
        tolerances_n=rest.tolerances,
        unexplained_n=rest.unexplained,
        unexplained_share=rest.share,
        gap=gap_size(
            before[used],
            after[used],
            problem.trial[used],
            problem.floor,
            None if alone is None else alone[used],
        ),
        candidates=candidate_results(ranked),
        why=reasons,
        seconds=time.monotonic() - began,
        recording=recording.name,
        rows=len(whole),
        rows_used=len(recording),
        rows_counted=int(used.sum()),
        arm=arm.name,
    )
    progress("done", 1.0)
    return Diagnosis(
        recording=recording,
        nominal=arm,
        verdict=verdict,
        amended=amended_arm(arm, values, explained.tolerances),
        predicted_before_n=nominal,
        predicted_after_n=predicted,
        held_out_n=held_out,
        counted=used,
        findings=tuple(finding.text for finding in findings),
    )


def _going_on(arm: Arm, recording: Recording, unseen: Collection[int]) -> GoingOn:
    simulator = ArmSimulator(without_effects(arm), recording)
    nominal = simulator.predict([{}])[0]
    if not np.isfinite(nominal).all():  # an arm that stands by what it lists
        return GoingOn(arm, ())
    return going_on(problem_of(recording, simulator, nominal, unseen), arm)


def candidate_results(ranked: Sequence[Ranked]) -> tuple[CandidateResult, ...]:
    """Every explanation with what it leaves; an unlisted effect leaves what none does."""
    none = next(r.explanation for r in ranked if r.explanation and not r.explanation.effects)
    return tuple(
        CandidateResult(
            effects=each.effects,
            held_out_rmse_n=h.held_out_rmse,
            probability=each.probability,
            held_out_ci95_n=rmse_interval_n(h.squares, h.count),
        )
        for each in ranked
        for h in (each.explanation or none,)
    )


def problem_of(
    recording: Recording, simulator: ArmSimulator, nominal: Array, unseen: Collection[int] = ()
) -> Problem:
    """The recording as the search works on it.

    Rows do not count where the arm may have more than one static equilibrium (`counted_rows`), nor
    do those of the trials `unseen`.
    """
    used = counted_rows(simulator.arm, recording, nominal)
    used &= ~np.isin(recording.trial, list(unseen))
    folds = folds_of(recording, unseen)
    problem = prepare(simulator, recording.tensions_n, recording.trial, folds, used)
    rows = rows_along_path(recording)
    if len(rows) > _SKETCH_SHARE * len(recording):
        return problem
    return sketched(problem, ArmSimulator(simulator.arm, recording.rows(rows)), rows)


def folds_of(recording: Recording, unseen: Collection[int] = ()) -> NDArray[np.int64]:
    """(T,) fold 0 to 4 of each trial, in the order of their numbers.

    Trials of one kind, by the segment that is loaded and by whether the arm moves, are dealt
    to the folds in turn, so that each fold leaves some of every kind to fit to. Those `unseen` are
    dealt apart from the others.
    """
    kinds: dict[tuple[bool, int, bool], list[int]] = {}
    for t, number in enumerate(np.unique(recording.trial)):
        rows = recording.trial == number
        moves = bool((np.ptp(recording.command_rad[rows], axis=0) > 0.0).any())
        kind = number in unseen, int(recording.load_segment[rows].max()), moves
        kinds.setdefault(kind, []).append(t)
    dealt = [t for kind in sorted(kinds) for t in kinds[kind]]
    fold = np.empty(len(dealt), dtype=np.int64)
    fold[dealt] = np.arange(len(dealt)) % min(FOLDS, len(dealt))
    return fold


def gap_size(
    before_n: Array,
    after_n: Array,
    trial: NDArray[np.int64],
    floor_n: float,
    effects_n: Array | None = None,
) -> Gap:
    """Sizes over residuals (R, M) before and after, with a bootstrap over trials (R,).

    `effects_n` (R, M) are those with the effects alone, if any are named.

    The floor is that of the sensors; manufacturing tolerances are in the amended arm's own file.
    """
    trial = np.unique(trial, return_inverse=True)[1]  # a draw of empty trials has no size
    squares = [np.bincount(trial, (each**2).sum(-1)).astype(float) for each in (before_n, after_n)]
    count = np.bincount(trial).astype(float) * before_n.shape[1]
    drawn = zip(*(_bootstrapped_rms(each, count) for each in squares), strict=True)
    fractions = [removed_fraction(before, after, floor_n) for before, after in drawn]
    low, high = np.quantile(fractions, [0.025, 0.975])
    before, after = (float(np.sqrt(each.sum() / count.sum())) for each in squares)
    return Gap(
        before_n=before,
        after_n=after,
        floor_n=floor_n,
        removed_fraction=removed_fraction(before, after, floor_n),
        ci95=(float(low), float(high)),
        by_cable_n=tuple(float(v) for v in np.sqrt((before_n**2).mean(0))),
        effects_n=None if effects_n is None else float(np.sqrt((effects_n**2).mean())),
    )


def rmse_interval_n(squares: Array, count: Array) -> tuple[float, float]:
    """95 % interval of the root mean square of squares (T,) of trials, by bootstrap over them."""
    sizes = _bootstrapped_rms(squares[count > 0], count[count > 0])
    low, high = np.quantile(sizes, [0.025, 0.975])
    return float(low), float(high)


def _bootstrapped_rms(squares: Array, count: Array) -> Array:
    """(draws,) root mean squares of trials (T,) drawn with replacement, the same at each call.

    `scipy.stats.bootstrap` takes samples of one statistic; these are ratios of two sums.
    """
    drawn = np.random.default_rng(0).integers(0, len(count), (_DRAWS, len(count)))
    return np.asarray(np.sqrt(squares[drawn].sum(-1) / count[drawn].sum(-1)))


def foremost(explanation: Explanation, candidates: Sequence[Candidate]) -> dict[Term, float]:
    """The values in those places that matter, effect by effect."""
    parameters = parameters_of(candidates)
    changes: dict[tuple[str, str], float] = {}
    for column, (term, value) in zip(explanation.columns, explanation.values.items(), strict=True):
        if parameters[term].role == "size":
            size = float(np.sqrt((column**2).mean())) * abs(to_scaled(parameters[term], value))
            changes[term[:2]] = float(np.hypot(changes.get(term[:2], 0.0), size))
    largest = {
        effect: max(size for (name, _), size in changes.items() if name == effect)
        for effect in explanation.effects
    }
    return {
        term: value
        for term, value in explanation.values.items()
        if changes[term[:2]] >= NEGLIGIBLE * largest[term.effect]
    }


def where(values: Mapping[Term, float], regimes: tuple[str, ...]) -> Where:
    """The places by kind; an effect of the whole arm names none."""
    # of crosstalk, the channel that it comes from
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


def estimates(
    values: Mapping[Term, float],
    deviations: Mapping[Term, float],
    candidates: Sequence[Candidate],
) -> dict[str, FittedNumber]:
    """Numbers with units, and intervals within what is plausible.

    The place is in the name where there are several, of one effect or of two.
    """
    parameters = parameters_of(candidates)
    single = len({term[:2] for term in values}) == 1
    found = {}
    for term, value in values.items():
        parameter, half = parameters[term], deviations[term]
        found[f"{term.effect}.{term.parameter}" if single else str(term)] = FittedNumber(
            value=value,
            unit=parameter.unit,
            ci95=(max(value - half, parameter.low), min(value + half, parameter.high)),
        )
    return found
