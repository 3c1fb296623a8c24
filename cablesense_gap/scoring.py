"""Verdicts against answers that were withheld: the score sheet (docs/verdict.md)."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, median
from typing import Any

import numpy as np

from cablesense_base import CableSenseError
from cablesense_base.files import read_bounded_text
from cablesense_gap.verdict import (
    CANNOT_TELL,
    MAX_FILE_BYTES,
    NONE,
    UNKNOWN,
    Verdict,
    checked_effects,
    joined,
    read_verdict,
)


class ScoreError(CableSenseError):
    """Verdicts or answers that cannot be scored: names the fault and the remedy."""


CLEAR_GAP_FLOORS = 5.0
"""A gap of at least this many noise floors is called clear."""
_COLUMNS = ("recording", "effects", "where")


@dataclass(frozen=True)
class Truth:
    """The truth about one recording.

    Attributes:
        recording: its name, without a suffix.
        effects: `("none",)`, `("unknown",)`, or names in alphabetical order.
        where: text with the names of the places; empty if the answer names none.
        gap_over_floor: RMS gap of the nominal arm in noise floors, if known.
        each_gap_n: RMS gap of each of the effects alone, if known.
    """

    recording: str
    effects: tuple[str, ...]
    where: str = ""
    gap_over_floor: float | None = None
    each_gap_n: tuple[float, ...] = ()


def read_answers(path: str | Path) -> tuple[Truth, ...]:
    """Read answers: CSV with `recording,effects,where`; effects are joined by `+`.

    Raises:
        ScoreError: the file cannot be read, misses a column, or has an invalid row.
    """
    try:
        text = read_bounded_text(path, MAX_FILE_BYTES, "a table of answers", ScoreError)
        table = csv.DictReader(text.splitlines(), skipinitialspace=True)
        rows = list(table)
    except (ValueError, csv.Error) as error:
        raise ScoreError(f"{path}: cannot be read as CSV text ({error})") from error
    missing = [name for name in _COLUMNS if name not in (table.fieldnames or ())]
    if missing:
        raise ScoreError(f"{path}: misses column {missing[0]}; answers have {', '.join(_COLUMNS)}")
    if not rows:
        raise ScoreError(f"{path}: has no rows; one for each recording is right")
    answers = tuple(_answer(f"{path}: row {i}", row) for i, row in enumerate(rows, start=1))
    name, count = Counter(answer.recording for answer in answers).most_common(1)[0]
    if count > 1:
        raise ScoreError(f"{path}: recording {name} stands twice; each must be once")
    return answers


def _answer(at: str, row: dict[str, str | None]) -> Truth:
    cells = {key: (value or "").strip() for key, value in row.items() if isinstance(key, str)}
    recording = Path(cells["recording"]).name.removesuffix(".gz").removesuffix(".csv")
    if not recording:
        raise ScoreError(f"{at}: names no recording")
    effects = tuple(sorted(name.strip() for name in cells["effects"].split("+")))
    if not all(re.fullmatch("[a-z][a-z0-9_]*", name) for name in effects):
        raise ScoreError(f"{at}: effects = {cells['effects'][:80]!r}; must be names joined by +")
    try:
        checked_effects(effects)
    except ValueError as error:
        raise ScoreError(f"{at}: effects {error}") from None
    gap = _numbers(at, cells, "gap_over_floor", 1)
    each_gap_n = _numbers(at, cells, "each_gap_n", len(effects))
    return Truth(recording, effects, cells["where"], gap[0] if gap else None, each_gap_n)


def _numbers(at: str, cells: Mapping[str, str], column: str, count: int) -> tuple[float, ...]:
    """The numbers in a cell; none if it is empty or missing."""
    cell = cells.get(column, "")
    numbers = list[float]()
    if not cell:
        return ()
    with suppress(ValueError):
        numbers = [float(number) for number in cell.split()]
    if len(numbers) != count or not all(0.0 <= number < math.inf for number in numbers):
        what = "a number" if count == 1 else f"{count} numbers"
        raise ScoreError(f"{at}: {column} = {cell[:40]!r}; must be {what} from 0 up")
    return tuple(numbers)


def read_verdicts(folder: str | Path, recordings: Iterable[str]) -> dict[str, Verdict]:
    """Read the verdicts on these recordings; other files in the folder are ignored.

    Raises:
        ScoreError: no such folder; a recording without a verdict, or with two.
        VerdictError: a file is no verdict.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ScoreError(f"{folder}: no such folder; give the one that holds the verdicts")
    verdicts = {}
    for name in recordings:
        places = folder / name / "verdict.json", folder / f"{name}.json"
        paths = [path for path in places if path.is_file()]
        if len(paths) > 1:
            raise ScoreError(f"{folder}: has {name}/verdict.json and {name}.json; keep one")
        if not paths:
            raise ScoreError(
                f"{folder}: no verdict on {name}; every recording of the answers needs its "
                f"{name}/verdict.json or {name}.json"
            )
        verdicts[name] = read_verdict(paths[0])
    return verdicts


@dataclass(frozen=True)
class Proportion:
    """A share of cases with its 95 % interval; without a case the value is None.

    Wilson's score interval holds for few cases and for shares of 0 and 1 too (E. B. Wilson,
    Journal of the American Statistical Association 22 (1927) 209-212).
    """

    value: float | None
    ci95: tuple[float, float]
    hits: int
    count: int


def proportion(outcomes: Iterable[bool]) -> Proportion:
    """The share of the outcomes that are true."""
    from scipy.stats import binomtest

    listed = [bool(outcome) for outcome in outcomes]
    hits = sum(listed)
    count = len(listed)
    if not count:
        return Proportion(None, (0.0, 1.0), 0, 0)
    low, high = binomtest(hits, count).proportion_ci(method="wilson")
    return Proportion(hits / count, (float(low), float(high)), hits, count)


@dataclass(frozen=True)
class Reliability:
    """Stated probabilities of verdicts against whether they were right.

    Attributes:
        brier: mean square of (probability - outcome); 0 is best, 0.25 is a coin's.
        expected_error: mean over cases of the difference between the mean probability and the
            share of right verdicts, in ten even bins of the probability.
    """

    brier: float
    expected_error: float


def reliability(probability: Sequence[float], right: Sequence[bool]) -> Reliability:
    """Brier score and expected calibration error of stated probabilities.

    G. W. Brier, Monthly Weather Review 78 (1950) 1-3; M. P. Naeini et al., AAAI 2015.
    """
    stated = np.asarray(probability, dtype=float)
    outcome = np.asarray(right, dtype=float)
    member = np.minimum((stated * 10).astype(int), 9)  # 1.0 belongs to the last bin
    apart = [abs((stated - outcome)[member == k].sum()) for k in range(10)]
    return Reliability(
        brier=float(((stated - outcome) ** 2).mean()),
        expected_error=float(sum(apart) / len(stated)),
    )


@dataclass(frozen=True)
class BudgetScore:
    """Scores of the budgets, over the effects of all recordings with effects of the library.

    Attributes:
        named: effects that change readings by 5 noise floors or more and are named.
        false_names: of all names given, those of absent effects.
        shares: of effects named rightly, those whose share is within a third of the truth.
        median_removed_fraction: of the gap on held-out trials, over recordings.
    """

    named: Proportion
    false_names: Proportion
    shares: Proportion
    median_removed_fraction: float | None


def budget_score(cases: Sequence[tuple[Verdict, Truth]]) -> BudgetScore:
    """Budgets against answers that give the gap of each effect."""
    named = []
    false = []
    shares = []
    removed = []
    for verdict, answer in cases:
        if answer.effects[0] in (NONE, UNKNOWN):
            continue
        names = () if verdict.effects[0] in (CANNOT_TELL, NONE, UNKNOWN) else verdict.effects
        false += [name not in answer.effects for name in names]
        removed.append(verdict.gap.removed_fraction if names else 0.0)
        for effect, gap_n in zip(answer.effects, answer.each_gap_n, strict=False):
            if gap_n >= CLEAR_GAP_FLOORS * verdict.gap.floor_n:
                named.append(effect in names)
            if effect in verdict.shares:
                shares.append(abs(verdict.shares[effect].share_n - gap_n) <= gap_n / 3.0)
    return BudgetScore(
        proportion(named),
        proportion(false),
        proportion(shares),
        median(removed) if removed else None,
    )


@dataclass(frozen=True)
class ScoreSheet:
    """Scores of the verdicts; docs/verdict.md says which cases each counts.

    A recording has one effect of the library (`singles`), two (`doubles`), `none` or `unknown`.
    """

    cases: int
    confusion: dict[str, dict[str, int]]
    exact: Proportion
    top2: Proportion
    truth_in_group: Proportion
    singles_exact: Proportion
    clear_singles_exact: Proportion
    doubles_both: Proportion
    doubles_one: Proportion
    false_alarms: Proportion
    unknown_recall: Proportion
    where: Proportion
    by_effect: dict[str, Proportion]
    mean_probability_on_truth: float
    budgets: BudgetScore
    calibration: Reliability
    median_removed_fraction: float | None
    wrong: tuple[str, ...]


def score(verdicts: Mapping[str, Verdict], answers: Sequence[Truth]) -> ScoreSheet:
    """Score verdicts, by recording, against answers; verdicts without an answer do not count.

    Raises:
        ScoreError: no answers, or one without a verdict.
    """
    import pandas as pd

    if not answers:
        raise ScoreError("no answers to score against; give at least one")
    without = next((a.recording for a in answers if a.recording not in verdicts), None)
    if without is not None:
        raise ScoreError(f"no verdict on {without}; every recording of the answers needs one")
    cases = pd.DataFrame([_judged(verdicts[answer.recording], answer) for answer in answers])
    right, none, unknown, singles, doubles = (
        cases[chosen]
        for chosen in (cases.exact, *(cases.kind == kind for kind in (NONE, UNKNOWN, "1", "2")))
    )
    removed = right.removed[right.kind.isin(("1", "2"))]
    confusion: dict[str, dict[str, int]] = {}
    for (truth, named), count in cases.groupby(["truth", "named"]).size().items():
        confusion.setdefault(truth, {})[named] = int(count)
    return ScoreSheet(
        cases=len(cases),
        confusion=confusion,
        exact=proportion(cases.exact),
        top2=proportion(cases.top2),
        truth_in_group=proportion(cases.in_group),
        singles_exact=proportion(singles.exact),
        clear_singles_exact=proportion(singles.exact[singles.clear]),
        doubles_both=proportion(doubles.exact),
        doubles_one=proportion(doubles.names_one),
        false_alarms=proportion(~none.exact),
        unknown_recall=proportion(unknown.exact),
        where=proportion(right.places_right.dropna()),
        by_effect={
            name: proportion(effect_cases.exact) for name, effect_cases in singles.groupby("truth")
        },
        mean_probability_on_truth=fmean(cases.on_truth),
        budgets=budget_score([(verdicts[a.recording], a) for a in answers]),
        calibration=reliability(cases.probability, cases.exact),
        median_removed_fraction=median(removed) if len(removed) else None,
        wrong=tuple(cases.recording[~cases.exact]),
    )


def _judged(verdict: Verdict, answer: Truth) -> dict[str, Any]:
    """One verdict with its answer, as a row of the table that is counted."""
    truth = answer.effects
    named = verdict.effects
    gap = verdict.gap
    weighed: dict[tuple[str, ...], float] = {}
    for candidate in verdict.candidates:  # with something unlisted beside them and without
        known = weighed.get(candidate.effects, 0.0)
        weighed[candidate.effects] = known + candidate.probability
    others = [c.effects for c in verdict.ranked if c.effects != named]
    ratio = answer.gap_over_floor
    if ratio is None and gap.floor_n > 0.0:  # as the verdict measured it on the recording
        ratio = gap.before_n / gap.floor_n
    return {
        "recording": answer.recording,
        "truth": joined(truth),
        "named": joined(named),
        "kind": truth[0] if truth[0] in (NONE, UNKNOWN) else str(len(truth)),
        "clear": ratio is not None and ratio >= CLEAR_GAP_FLOORS,
        "exact": truth == named,
        "top2": truth in (named, *others[:1]),
        "in_group": truth == named or joined(truth) in verdict.ambiguity_group,
        "names_one": not set(truth).isdisjoint(named),
        "places_right": places_right(verdict, answer.where),
        "probability": verdict.probability,
        "on_truth": (weighed or {named: verdict.probability}).get(truth, 0.0),
        "removed": gap.removed_fraction,
    }


def places_right(verdict: Verdict, where: str) -> bool | None:
    """Whether the verdict has the same places as the answer; None if the answer has none.

    An arm's places are found whatever stands between them, and only the kinds that the answer
    names are compared. A robot's are words; of what one place does to another the first counts.
    """
    named = set(verdict.where.places)
    if verdict.of_robot:
        places = set(re.sub(r"_into_\S+", "", where).split())
        return named == places if places else None
    places = set(re.findall(r"(?:cable|segment|joint)_[1-9]\d*", where))
    kinds = {place.split("_")[0] for place in places}
    return {p for p in named if p.split("_")[0] in kinds} == places if places else None
