"""Which effects, in which places, explain a residual: chosen linear about one explanation.

The tolerances and the effects of that explanation are fitted along. A set of additions is grown
site by site; a site is an effect in one place. Several sets are grown at once, because the first
site that helps most is not always part of the best set.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from cablesense_base import Array
from cablesense_gap.diagnosis.columns import LinearEffect
from cablesense_gap.diagnosis.linear_fit import (
    Indices,
    Reduced,
    held_out_squares,
    products,
    solve,
    weight,
)
from cablesense_gap.diagnosis.problem import Explanation, Problem
from cablesense_sim.effects.effect import WHOLE_ARM

MOST_EFFECTS = 7
"""In one explanation: a recording of the usual protocol does not distinguish more."""

_WIDTH = 6
"""Sets that are grown at once."""


@dataclass(frozen=True)
class Proposal:
    """Effects to add to an explanation.

    Attributes:
        added: in the order in which they were chosen.
        coefficients: (K,) of their columns, scaled.
        beside: the explanation.
        forecast: cost of what the sum leaves on held-out trials, with the penalty.
        most_left: mean square; no fit if its starts leave more.
    """

    added: tuple[LinearEffect, ...]
    coefficients: Array
    beside: Explanation
    forecast: float
    most_left: float = np.inf

    @property
    def effects(self) -> tuple[str, ...]:
        """All names, in alphabetical order."""
        return tuple(sorted({*self.beside.effects, *(e.effect for e in self.added)}))


_Scored = tuple[float, list[int]]
"""The cost with its penalty, and the chosen sites by their positions among the offered ones."""


class Selection:
    """Linear effects among which additions to one explanation are chosen."""

    def __init__(
        self, problem: Problem, about: Explanation, offered: Sequence[LinearEffect]
    ) -> None:
        self._problem, self._about, self._offered = problem, about, offered
        columns = [problem.tolerance_columns, about.columns, *(e.columns for e in offered)]
        self._base = len(problem.tolerance_columns) + len(about.columns)
        ends = self._base + np.cumsum([len(e.columns) for e in offered], dtype=np.int64)
        self._owned = [
            np.arange(n - len(e.columns), n) for n, e in zip(ends, offered, strict=True)
        ]
        fold_of_row = problem.fold[problem.trial]
        residual = problem.readings - about.without_tolerances
        self._data = products(np.concatenate(columns), residual, fold_of_row, problem.used)
        self._precision = np.concatenate([np.ones(self._base), *(e.precision for e in offered)])
        self._folds = np.arange(len(self._data.count))
        self._known = Counter(effect for effect, _ in about.sites)
        ranges = problem.parameters
        self._positive = [
            np.array(
                [ranges[term].low >= 0.0 and ranges[term].role == "size" for term in e.varied]
            )
            for e in offered
        ]

    def singles(self) -> list[Proposal]:
        """Each effect in its best places, the most promising first."""
        return self._proposals(self._single_effects())

    def _single_effects(self) -> list[_Scored]:
        sides: dict[tuple[str, bool], list[int]] = {}
        for k, linear in enumerate(self._offered):
            sides.setdefault((linear.effect, linear.place == WHOLE_ARM), []).append(k)
        best: dict[str, _Scored] = {}
        for (effect, _), own in sides.items():
            grown = self._grown(own, strict=True) or self._grown(own, strict=False)
            if grown and grown < best.get(effect, (np.inf, [])):
                best[effect] = grown
        return sorted(best.values(), key=lambda each: each[0])

    def additions(self) -> list[Proposal]:
        """For every set of effects that is promising their best places, most promising first."""
        best = {self._effects(chosen): (s, chosen) for s, chosen in self._single_effects()}
        level = sorted(best.values())[:_WIDTH]
        least = np.inf
        for _ in range(2 * MOST_EFFECTS):
            longer: dict[tuple[str, ...], _Scored] = {}
            for _, chosen in level:
                for score, extended in self._extended(chosen, range(len(self._offered))):
                    effects = self._effects(extended)
                    if score < longer.get(effects, (np.inf, []))[0]:
                        longer[effects] = score, extended
            tried = sorted(longer.values())[: 2 * _WIDTH]
            judged = [(self._score(chosen), chosen) for _, chosen in tried]
            level = sorted(each for each in judged if np.isfinite(each[0]))[:_WIDTH]
            for score, chosen in level:
                effects = self._effects(chosen)
                if score < best.get(effects, (np.inf, []))[0]:
                    best[effects] = score, chosen
            before, least = least, min((s / self._penalty(c) for s, c in level), default=np.inf)
            # a small gain suffices: many sites alike are worth their penalty only together
            if not level or 1.02 * least > before:
                break
        return self._proposals(best.values())

    def _grown(self, among: Sequence[int], *, strict: bool) -> _Scored | None:
        """One effect's sites added while each, or two at once, is worth its penalty."""
        score, chosen = np.inf, list[int]()
        while True:
            options = sorted(self._extended(chosen, among))[:4]  # the best of them exactly
            scored = [(self._score(option, strict=strict), option) for _, option in options]
            best = min(scored, default=(np.inf, chosen))
            if best[0] >= score or (not strict and chosen):
                return (score, chosen) if chosen else None
            score, chosen = best

    def _extended(self, chosen: Sequence[int], among: Sequence[int]) -> Iterator[_Scored]:
        """The chosen sites with one more, or two of one effect, each with a forecast."""
        first = np.concatenate([np.arange(self._base), *(self._owned[k] for k in chosen)])
        new = [k for k in among if self._fits(k, chosen)]
        if not new:
            return
        order = np.concatenate([first, *(self._owned[k] for k in new)])
        weight_ = weight(self._fitted(chosen)[1], self._problem.floor)
        reduced = Reduced(
            self._data.columns(order), len(first), self._precision[order], weight_, self._folds
        )
        ends = np.cumsum([len(self._owned[k]) for k in new])
        at = {k: np.arange(n - len(self._owned[k]), n) for k, n in zip(new, ends, strict=True)}
        options = [[k] for k in new]
        by_effect: dict[str, list[int]] = {}
        for k in new:
            if self._offered[k].place != WHOLE_ARM:
                by_effect.setdefault(self._offered[k].effect, []).append(k)
        # of two cables that pull against each other, either alone may explain nothing
        for own in by_effect.values():
            if len(own) <= 40:
                options += [
                    [a, b]
                    for a, b in combinations(own, 2)
                    if self._offered[a].place != self._offered[b].place
                ]
        count = len(self._problem.tolerance_terms)
        by_count: dict[int, list[list[int]]] = {}
        for option in options:
            by_count.setdefault(sum(len(at[k]) for k in option), []).append(option)
        for group in by_count.values():
            sets = np.array([np.concatenate([at[k] for k in option]) for option in group])
            left, chi2 = reduced.mean_squares(sets), reduced.base_chi2(sets, count)
            for option, square, off in zip(group, left, chi2, strict=True):
                both = [*chosen, *option]
                yield self._problem.cost(float(square), float(off)) * self._penalty(both), both

    def _fits(self, k: int, chosen: Sequence[int]) -> bool:
        """Whether a site may stand together with those that are chosen."""
        linear = self._offered[k]
        same = [self._offered[c].place for c in chosen if self._offered[c].effect == linear.effect]
        if not same and linear.effect not in self._known:
            return len({*self._known, *self._effects(chosen)}) < MOST_EFFECTS
        return linear.place not in same and (WHOLE_ARM not in {linear.place, *same} or not same)

    def _effects(self, chosen: Sequence[int]) -> tuple[str, ...]:
        names = {*self._about.effects, *(self._offered[k].effect for k in chosen)}
        return tuple(sorted(names))

    def _penalty(self, chosen: Sequence[int]) -> float:
        places = self._known + Counter(self._offered[k].effect for k in chosen)
        return self._problem.penalty(places)

    def _score(self, chosen: Sequence[int], *, strict: bool = True) -> float:
        """Cost with the penalty, at the weight of its residual; infinite for impossible sizes."""
        found, mean_square, chi2 = self._fitted(chosen)
        positive = np.concatenate([np.zeros(0, dtype=bool), *(self._positive[k] for k in chosen)])
        if strict and (found[self._base :][positive] < 0.0).any():
            return np.inf
        return self._problem.cost(mean_square, chi2) * self._penalty(chosen)

    def _proposals(self, found: Iterable[_Scored]) -> list[Proposal]:
        """The most promising first."""
        proposals = [
            Proposal(
                added=tuple(self._offered[k] for k in chosen),
                coefficients=self._fitted(chosen)[0][self._base :],
                beside=self._about,
                forecast=score,
            )
            for score, chosen in found
        ]
        return sorted(proposals, key=lambda proposal: proposal.forecast)

    def kept(self) -> list[int]:
        """Offered sites that are worth their penalty: one site or effect is removed at a time."""
        chosen = list(range(len(self._offered)))
        score = self._score(chosen, strict=False)
        while len(chosen) > 1:
            names = {self._offered[k].effect for k in chosen}
            fewer = [[c for c in chosen if c != k] for k in chosen]
            fewer += [[c for c in chosen if self._offered[c].effect != name] for name in names]
            tried = [(self._score(f, strict=False), f) for f in fewer if f]
            best = min(tried, default=(np.inf, chosen))
            if best[0] >= score:
                break
            score, chosen = best
        return chosen

    def left_without(self, effect: str) -> float:
        """The cost of all offered sites without one effect."""
        rest = [k for k, linear in enumerate(self._offered) if linear.effect != effect]
        return self._problem.cost(*self._fitted(rest)[1:])

    def _fitted(self, chosen: Sequence[int]) -> tuple[Array, float, float]:
        """Coefficients, the mean square left on held-out trials, and that of tolerances."""
        at: Indices = np.concatenate([np.arange(self._base), *(self._owned[k] for k in chosen)])
        part, precision, none = self._data.columns(at), self._precision[at], np.zeros(len(at))
        count, mean_square, problem = part.count.sum(), self._data.mean_square, self._problem
        for _ in range(2):  # first at the weight of the whole residual, then of what is left
            weight_ = weight(mean_square, problem.floor)
            squares = held_out_squares(part, precision, none, weight_, self._folds).sum()
            mean_square = float(squares / count)
        found = solve(part.gram.sum(0), part.moment.sum(0), precision, none, weight_)
        chi2 = float((found[: len(problem.tolerance_terms)] ** 2).sum())
        return found, mean_square, chi2
