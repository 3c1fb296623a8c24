"""Verdicts against answers: the score sheet."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, median

from cablesense_gap.scoring.answers import Answer
from cablesense_gap.scoring.calibration import Calibration, calibrate
from cablesense_gap.scoring.proportion import Proportion
from cablesense_gap.scoring.score_error import ScoreError
from cablesense_gap.verdict import NONE, UNKNOWN, Verdict, joined

CLEAR_GAP_FLOORS = 5.0
"""From this many noise floors up a gap is called clear."""

KINDS = ("cable", "segment", "joint")


@dataclass(frozen=True)
class Score:
    """What the verdicts are worth. `singles` and `doubles` are cases inside the library.

    Attributes:
        cases: number of recordings scored.
        confusion: counts by truth, then by verdict.
        exact: verdicts that name exactly the truth.
        top2: truth among the two explanations held most probable.
        truth_in_group: truth is the verdict or in its ambiguity group.
        singles_exact: of singles, exact ones.
        clear_singles_exact: the same where the gap is at least 5 noise floors.
        doubles_both: of doubles, those with both effects named and no other.
        doubles_one: of doubles, those with at least one effect named.
        false_alarms: of `none`, those with another verdict.
        unknown_recall: of `unknown`, those recognised.
        where: of correct verdicts whose answer names places, those that name the same ones.
        by_effect: exact verdicts by true effect, singles.
        by_form: exact verdicts by the plant's form, where answers give one.
        mean_probability_on_truth: of the candidate that is the truth, 0 where none is.
        brier_over_candidates: sum over candidates of (probability - outcome)², mean over cases.
        calibration: of the verdicts' own probability.
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
    calibration: Calibration
    median_removed_fraction: float | None
    wrong: tuple[str, ...]


@dataclass(frozen=True)
class _Case:
    verdict: Verdict
    answer: Answer

    @property
    def right(self) -> bool:
        return self.verdict.effects == self.answer.effects

    @property
    def single(self) -> bool:
        return len(self.answer.effects) == 1 and not (self.none or self.unknown)

    @property
    def double(self) -> bool:
        return len(self.answer.effects) > 1

    @property
    def none(self) -> bool:
        return self.answer.effects == (NONE,)

    @property
    def unknown(self) -> bool:
        return self.answer.effects == (UNKNOWN,)

    @property
    def clear(self) -> bool:
        given = self.answer.gap_over_floor
        gap = self.verdict.gap
        # the gap before is measured on the recording, so it does where answers are silent
        ratio = gap.before_n / gap.floor_n if given is None and gap.floor_n > 0.0 else given
        return ratio is not None and ratio >= CLEAR_GAP_FLOORS

    @property
    def in_top2(self) -> bool:
        others = [c.effects for c in self.verdict.ranked if c.effects != self.verdict.effects]
        return self.answer.effects in (self.verdict.effects, *others[:1])

    @property
    def in_group(self) -> bool:
        return self.right or joined(self.answer.effects) in self.verdict.ambiguity_group

    @property
    def probabilities(self) -> dict[tuple[str, ...], float]:
        weighed = {c.effects: c.probability for c in self.verdict.candidates}
        return weighed or {self.verdict.effects: self.verdict.probability}

    @property
    def places_right(self) -> bool:
        """The same set for each kind of place that the answer names."""
        return all(
            _of_kind(self.answer.places, kind) == _of_kind(self.verdict.where.places, kind)
            for kind in KINDS
            if _of_kind(self.answer.places, kind)
        )

    @property
    def brier(self) -> float:
        stated = self.probabilities
        others = sum(p**2 for effects, p in stated.items() if effects != self.answer.effects)
        return (1.0 - stated.get(self.answer.effects, 0.0)) ** 2 + others


def score(verdicts: Mapping[str, Verdict], answers: Sequence[Answer]) -> Score:
    """Score verdicts, by recording, against answers; verdicts without an answer do not count.

    Raises:
        ScoreError: no answers, or one without a verdict.
    """
    if not answers:
        raise ScoreError("no answers to score against; give at least one")
    without = next((a.recording for a in answers if a.recording not in verdicts), None)
    if without is not None:
        raise ScoreError(f"no verdict on {without}; every recording of the answers needs one")
    cases = [_Case(verdicts[answer.recording], answer) for answer in answers]
    right = [case for case in cases if case.right]
    removed = [c.verdict.gap.removed_fraction for c in right if c.single or c.double]
    singles = [case for case in cases if case.single]
    doubles = [case for case in cases if case.double]
    return Score(
        cases=len(cases),
        confusion=_confusion(cases),
        exact=Proportion.of(case.right for case in cases),
        top2=Proportion.of(case.in_top2 for case in cases),
        truth_in_group=Proportion.of(case.in_group for case in cases),
        singles_exact=Proportion.of(case.right for case in singles),
        clear_singles_exact=Proportion.of(case.right for case in singles if case.clear),
        doubles_both=Proportion.of(case.right for case in doubles),
        doubles_one=Proportion.of(
            not set(case.answer.effects).isdisjoint(case.verdict.effects) for case in doubles
        ),
        false_alarms=Proportion.of(not case.right for case in cases if case.none),
        unknown_recall=Proportion.of(case.right for case in cases if case.unknown),
        where=Proportion.of(case.places_right for case in right if case.answer.places),
        by_effect=_exact_by(singles, lambda case: case.answer.effects[0]),
        by_form=_exact_by(cases, lambda case: case.answer.form),
        mean_probability_on_truth=fmean(
            case.probabilities.get(case.answer.effects, 0.0) for case in cases
        ),
        brier_over_candidates=fmean(case.brier for case in cases),
        calibration=calibrate(
            [case.verdict.probability for case in cases], [case.right for case in cases]
        ),
        median_removed_fraction=median(removed) if removed else None,
        wrong=tuple(case.answer.recording for case in cases if not case.right),
    )


def _confusion(cases: Sequence[_Case]) -> dict[str, dict[str, int]]:
    counts: dict[str, dict[str, int]] = {}
    for case in sorted(cases, key=lambda c: (joined(c.answer.effects), joined(c.verdict.effects))):
        row = counts.setdefault(joined(case.answer.effects), {})
        said = joined(case.verdict.effects)
        row[said] = row.get(said, 0) + 1
    return counts


def _exact_by(cases: Sequence[_Case], key: Callable[[_Case], str]) -> dict[str, Proportion]:
    names = sorted({key(case) for case in cases} - {""})
    return {name: Proportion.of(c.right for c in cases if key(c) == name) for name in names}


def _of_kind(places: frozenset[str], kind: str) -> set[str]:
    return {place for place in places if place.startswith(f"{kind}_")}
