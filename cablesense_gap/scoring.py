"""Verdicts against answers that were withheld: the score sheet."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean, median
from typing import Any

import numpy as np

from cablesense_base import CableSenseError
from cablesense_base.files import read_bounded_text
from cablesense_gap.verdict import NONE, UNKNOWN, Verdict, joined, read_verdict


class ScoreError(CableSenseError):
    """Verdicts or answers that cannot be scored: names the fault and the remedy."""


CLEAR_GAP_FLOORS = 5.0
"""A gap of at least this many noise floors is called clear."""

_COLUMNS = ("recording", "effects", "where")
_MAX_FILE_BYTES = 10_000_000
_BINS = 10
_COUNTED = {1: "one", 2: "two"}
_NAME = re.compile(r"[a-z][a-z0-9_]*")
_PLACE = re.compile(r"(?:cable|segment|joint)_[1-9]\d*")


@dataclass(frozen=True)
class Truth:
    """The truth about one recording.

    Attributes:
        recording: its name, without a suffix.
        effects: `("none",)`, `("unknown",)`, or names in alphabetical order.
        places: cables, segments and joints that the answer names; empty if it names none.
        names: the words of `where`, of a robot the names of its joints, bodies and tendons.
        gap_over_floor: RMS gap of the nominal arm in noise floors, if the file gives it.
        form: which form of the effect the plant has, if the file gives it.
        each_gap_n: RMS gap of each of the effects alone, if the file gives it.
    """

    recording: str
    effects: tuple[str, ...]
    places: frozenset[str] = frozenset()
    gap_over_floor: float | None = None
    form: str = ""
    each_gap_n: tuple[float, ...] = ()
    names: frozenset[str] = frozenset()


def read_answers(path: str | Path) -> tuple[Truth, ...]:
    """Read answers: CSV with `recording,effects,where`; effects are joined by `+`.

    In `where`, places are found whatever stands between them, so that
    `cable_2_into_cable_5` and `cable_2 cable_5` mean the same.

    Raises:
        ScoreError: the file cannot be read, a column is missing, a row cannot be.
    """
    try:
        text = read_bounded_text(path, _MAX_FILE_BYTES, "a table of answers", ScoreError)
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
    if not all(_NAME.fullmatch(name) for name in effects) or len(set(effects)) < len(effects):
        raise ScoreError(
            f"{at}: effects = {cells['effects'][:80]!r}; must be names joined by +, each once"
        )
    for alone in (NONE, UNKNOWN):
        if alone in effects and len(effects) > 1:
            raise ScoreError(f"{at}: effects = {'+'.join(effects)}; {alone} must stand alone")
    gap = _numbers(at, cells, "gap_over_floor", 1)
    each_gap_n = _numbers(at, cells, "each_gap_n", len(effects))
    places = frozenset(_PLACE.findall(cells["where"]))
    # of what one place does to another the first counts, as in verdicts
    names = frozenset(re.sub(r"_into_\S+", "", cells["where"]).split())
    form = cells.get("form", "")
    return Truth(recording, effects, places, gap[0] if gap else None, form, each_gap_n, names)


def _numbers(at: str, cells: Mapping[str, str], column: str, count: int) -> tuple[float, ...]:
    """Those of a cell, or none where it is empty or not there."""
    cell, found = cells.get(column, ""), list[float]()
    if not cell:
        return ()
    with suppress(ValueError):
        found = [float(number) for number in cell.split()]
    if len(found) != count or not all(0.0 <= number < math.inf for number in found):
        what = "a number" if count == 1 else f"{count} numbers"
        raise ScoreError(f"{at}: {column} = {cell[:40]!r}; must be {what} from 0 up")
    return tuple(found)


@dataclass(frozen=True)
class Bin:
    """Cases whose stated probability lies in one tenth of 0 to 1."""

    low: float
    high: float
    count: int
    mean_probability: float
    share_right: float


@dataclass(frozen=True)
class Reliability:
    """Stated probabilities of verdicts against whether they were right.

    Attributes:
        brier: mean square of (probability - outcome); 0 is best, 0.25 is a coin's.
        expected_error: mean over cases of what a bin's mean probability and share differ by.
        bins: those that hold a case.
    """

    brier: float
    expected_error: float
    bins: tuple[Bin, ...]


def reliability(probability: Sequence[float], right: Sequence[bool]) -> Reliability:
    """Brier score and expected calibration error of stated probabilities, ten even bins.

    G. W. Brier, Monthly Weather Review 78 (1950) 1-3; M. P. Naeini et al., AAAI 2015.
    """
    stated, outcome = np.asarray(probability, dtype=float), np.asarray(right, dtype=float)
    member = np.minimum((stated * _BINS).astype(int), _BINS - 1)  # 1.0 belongs to the last
    bins = tuple(
        Bin(
            low=k / _BINS,
            high=(k + 1) / _BINS,
            count=int((member == k).sum()),
            mean_probability=float(stated[member == k].mean()),
            share_right=float(outcome[member == k].mean()),
        )
        for k in np.unique(member).tolist()
    )
    apart = sum(b.count * abs(b.mean_probability - b.share_right) for b in bins)
    return Reliability(
        brier=float(((stated - outcome) ** 2).mean()),
        expected_error=apart / len(stated),
        bins=bins,
    )


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
    """How many of the outcomes are true."""
    from scipy.stats import binomtest

    listed = [bool(outcome) for outcome in outcomes]
    hits, count = sum(listed), len(listed)
    if not count:
        return Proportion(None, (0.0, 1.0), 0, 0)
    low, high = binomtest(hits, count).proportion_ci(method="wilson")
    return Proportion(hits / count, (float(low), float(high)), hits, count)


@dataclass(frozen=True)
class BudgetScore:
    """Scores of the budgets, over the effects of all recordings with effects of the library.

    Attributes:
        named: effects that change readings by 5 noise floors or more and are named.
        false_names: of all names given, those of effects that are not there.
        shares: of effects named rightly, those whose share is within a third of the truth.
        median_removed_fraction: of the gap on held-out trials, over recordings.
    """

    named: Proportion
    false_names: Proportion
    shares: Proportion
    median_removed_fraction: float | None


def budget_score(cases: Sequence[tuple[Verdict, Truth]]) -> BudgetScore:
    """Budgets against answers that give the gap of each effect."""
    named, false, shares, removed = [], [], [], []
    for verdict, answer in cases:
        if answer.effects[0] in (NONE, UNKNOWN):
            continue
        names = () if verdict.effects[0] in (NONE, UNKNOWN) else verdict.effects
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
    """Scores of the verdicts.

    A recording has one effect of the library (`singles`), two (`doubles`), `none` or `unknown`.

    Attributes:
        confusion: counts by truth, then by verdict.
        exact: verdicts that name exactly the truth.
        top2: truth among the two most probable explanations.
        truth_in_group: truth is the verdict or in its ambiguity group.
        clear_singles_exact: exact singles whose gap is at least 5 noise floors.
        doubles_both: doubles with both effects named and no other.
        doubles_one: doubles with at least one effect named.
        false_alarms: of `none`, those with another verdict.
        unknown_recall: of `unknown`, those recognised.
        where: of correct verdicts whose answer names places, those that name the same ones.
        by_effect: exact singles by true effect.
        by_form: exact verdicts by the plant's form, where answers give one.
        mean_probability_on_truth: of the candidate that is the truth, 0 where none is.
        brier_over_candidates: sum over candidates of (probability - outcome)², mean over cases.
        budgets: effects and shares over all recordings with effects of the library.
        reliability: of the verdicts' own probability.
        median_removed_fraction: of correct verdicts on singles and doubles; None without one.
        wrong: recordings whose verdict is not exact.
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
    by_form: dict[str, Proportion]
    mean_probability_on_truth: float
    brier_over_candidates: float
    budgets: BudgetScore
    reliability: Reliability
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
        for chosen in (cases.exact, *(cases.kind == k for k in (NONE, UNKNOWN, "one", "two")))
    )
    removed = right.removed[right.kind.isin(("one", "two"))]
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
        where=proportion(right.places_right[right.has_places]),
        by_effect={name: proportion(own.exact) for name, own in singles.groupby("truth")},
        by_form={name: proportion(own.exact) for name, own in cases.groupby("form") if name},
        mean_probability_on_truth=fmean(cases.on_truth),
        brier_over_candidates=fmean(cases.brier),
        budgets=budget_score([(verdicts[a.recording], a) for a in answers]),
        reliability=reliability(cases.probability, cases.exact),
        median_removed_fraction=median(removed) if len(removed) else None,
        wrong=tuple(cases.recording[~cases.exact]),
    )


def _judged(verdict: Verdict, answer: Truth) -> dict[str, Any]:
    """One verdict with its answer, as a row of the table that is counted."""
    truth, named, gap = answer.effects, verdict.effects, verdict.gap
    weighed = {c.effects: c.probability for c in verdict.candidates}
    weighed = weighed or {named: verdict.probability}
    others = [c.effects for c in verdict.ranked if c.effects != named]
    ratio = answer.gap_over_floor
    if ratio is None and gap.floor_n > 0.0:  # as the verdict measured it on the recording
        ratio = gap.before_n / gap.floor_n
    kinds = {place.split("_")[0] for place in answer.places}
    named_places = answer.names or answer.places
    on_truth = weighed.get(truth, 0.0)
    return {
        "recording": answer.recording,
        "form": answer.form,
        "truth": joined(truth),
        "named": joined(named),
        "kind": truth[0] if truth[0] in (NONE, UNKNOWN) else _COUNTED.get(len(truth), "several"),
        "clear": ratio is not None and ratio >= CLEAR_GAP_FLOORS,
        "exact": truth == named,
        "top2": truth in (named, *others[:1]),
        "in_group": truth == named or joined(truth) in verdict.ambiguity_group,
        "names_one": not set(truth).isdisjoint(named),
        # the same set for each kind of place that the answer names
        "has_places": bool(named_places if verdict.channels else kinds),
        "places_right": set(verdict.where.places) == named_places
        if verdict.channels
        else {p for p in verdict.where.places if p.split("_")[0] in kinds} == answer.places,
        "probability": verdict.probability,
        "on_truth": on_truth,
        "brier": (1.0 - on_truth) ** 2 + sum(p**2 for e, p in weighed.items() if e != truth),
        "removed": gap.removed_fraction,
    }


def as_json(score: ScoreSheet) -> dict[str, Any]:
    """The score as plain values for a JSON file."""
    plain = asdict(score)
    plain["calibration"] = plain.pop("reliability")
    return plain


def read_verdicts(folder: str | Path, recordings: Iterable[str]) -> dict[str, Verdict]:
    """Read the verdicts on these recordings; what else lies in the folder is left alone.

    Raises:
        ScoreError: no such folder; a recording without a verdict, or with two.
        VerdictError: a file is no verdict.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ScoreError(f"{folder}: no such folder; give the one that holds the verdicts")
    found, missing = {}, []
    for name in recordings:
        places = folder / name / "verdict.json", folder / f"{name}.json"
        paths = [path for path in places if path.is_file()]
        if len(paths) > 1:
            raise ScoreError(f"{folder}: has {name}/verdict.json and {name}.json; keep one")
        if paths:
            found[name] = read_verdict(paths[0])
        else:
            missing.append(name)
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise ScoreError(
            f"{folder}: no verdict on {missing[0]}{more}; every recording of the answers needs "
            f"its {missing[0]}/verdict.json or {missing[0]}.json"
        )
    return found
