"""The search among candidates: what is cheap to simulate first, then what depends on history.

Screening gives where a search for numbers begins; the simulator itself fits them (`gauss_newton`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_base.workers import WorkerPool
from cablesense_gap.diagnosis.fitting import each_alone, fit, reselect_places
from cablesense_gap.diagnosis.gauss_newton import final_refinement, refine, refit
from cablesense_gap.diagnosis.joint_selection import JointSelection, left_out
from cablesense_gap.diagnosis.places import WORTH, linear_effects
from cablesense_gap.diagnosis.problem import Explanation, Problem, excess
from cablesense_gap.diagnosis.screening import (
    Offered,
    Screened,
    at_usual_size,
    by_forecast,
    promising,
    screen_pairs,
    screen_singles,
)
from cablesense_gap.simulator import Assignment, Candidate, Simulator

Progress = Callable[[str, float], None]
"""Called with what is under way, and which share of the whole is done."""

_MOST_SINGLES, _MOST_PAIRS, _MOST_EXPENSIVE_PAIRS, _MOST_REPLACED = 6, 4, 4, 4
"""That are fitted after a screening."""
_MOST_STARTS, _WORTH_GROWING, _WORTH_STARTING = 2, 2.0, 0.85
"""Pairs from which others are added: they leave at most so many times as much as the best
explanation, and so much of what the best single effect leaves."""
_WORTH_PAIRING = 0.8
"""Pairs with history, as screened, leave at most so much of what the best explanation leaves."""
_FAR_BEHIND = 6.0
"""A screening that leaves so many times as much as a fit is no rival of it."""
_RESOLVED, _BARELY = 0.04, 1.25
"""Of the gap, and of the floor: where no more is left, nothing further is sought."""
_SLIGHTLY = 0.95
"""What leaves more than this share of the gap, as screened, is not the cause by itself."""
_ALIKE = 1.02
"""Of two fits of the same effects that leave so nearly the same, the likelier numbers are kept."""
_LEAST_SHOWN = 0.5
"""Floors, of the part of an effect beside others."""
_FAR_OFF = 5.0
"""Standard deviations of a tolerance."""
_BORNE_OUT = 1.6
"""Effects without which so much more is left are certain to be needed."""


def search(
    problem: Problem, progress: Progress = lambda *_: None, workers: int = 1
) -> list[Explanation]:
    """Every explanation that was fitted, that of tolerances alone first.

    History-dependent effects are expensive to simulate: they are left alone where one of the
    others, or two of them, leave next to nothing, and pairs with them where one of them leaves
    little above the floor. With more than one worker, candidates are screened and fitted in as
    many processes.
    """
    none = refine(problem, {}, [[]])
    assert none is not None
    with WorkerPool(workers, problem) as pool:
        return [none, *_Search(problem, pool, progress, none).run()]


class _Search:
    def __init__(
        self, problem: Problem, pool: WorkerPool, progress: Progress, none: Explanation
    ) -> None:
        self._whole, self._pool, self._progress = problem, pool, progress
        self._found: dict[tuple[str, ...], Explanation] = {}
        self._refined: list[Explanation] = []
        self._about: dict[int, Problem] = {}
        self._go_on_with(problem, none)

    def _go_on_with(self, problem: Problem, none: Explanation) -> None:
        """All rows, or those of the sketch."""
        self._problem, self._none = problem, none
        spread = _Spread(problem.simulator, self._map, self._pool.workers)
        self._spread = replace(problem, simulator=spread, sketch=None)

    def _map(self, function: Callable[..., Any], values: Iterable[Any]) -> Iterator[Any]:
        """What a function makes of the present problem and each of some values."""
        on_sketch = self._problem is not self._whole
        return self._pool.map(partial(_on_sketch if on_sketch else _on_whole, function), values)

    def run(self) -> list[Explanation]:
        """The best explanation for every effect and every two that were fitted."""
        self._explore()
        self._replace()
        self._refine_best(2)
        self._leave_out()
        self._progress("done", 1.0)
        worth_it = [h for h in self._found.values() if not self._is_idle(h)]
        return sorted(worth_it, key=lambda h: (len(h.effects), h.held_out_rmse))

    def _explore(self) -> None:
        problem, candidates = self._problem, self._problem.simulator.candidates
        barely = self._none.held_out_rmse <= _BARELY * problem.floor
        cheap = self._offer([c for c in candidates if not c.history_dependent], 0.0)
        screened = screen_singles(problem, cheap)
        best = self._least(screened)
        self._fit(promising(problem, screened[:_MOST_SINGLES], best), "single effects", 0.1)
        self._reselect_best(cheap)
        if barely or self._is_resolved():
            return
        self._select_jointly({}, self._best())
        if not self._is_resolved():
            pairs = self._pairs(cheap)[:_MOST_PAIRS]
            self._fit(pairs, "pairs of effects", 0.25)
            self._reselect_best(cheap)
            for start in self._starts({pair.effects for pair in pairs}):
                if not (self._is_resolved() or set(start.effects) < set(self._best().effects)):
                    self._select_jointly({}, start)
        if not self._is_resolved():
            self._explore_history_dependent(cheap, best)

    def _best(self) -> Explanation:
        return min([self._none, *self._found.values()], key=self._problem.cost_of)

    def _explore_history_dependent(self, cheap: Offered, best: float) -> None:
        """By the sketch, if there is one; what comes of it is judged on all rows."""
        sketch, none, known = self._whole.sketch, self._none, self._found
        if sketch is None:
            self._fit_history_dependent(cheap, best)
            return
        reduced = {effects: sketch.explanation(h) for effects, h in known.items()}
        self._found = dict(reduced)
        self._go_on_with(sketch.problem, sketch.explanation(none))
        few = {
            name: [
                tuple(replace(e, columns=e.columns[:, sketch.rows]) for e in every)
                for every in shapes
            ]
            for name, shapes in cheap.items()
        }
        self._fit_history_dependent(few, best)
        self._refine_best(2)
        self._leave_out()
        self._progress("judging what depends on the past on all rows", 0.95)
        most = _FAR_BEHIND * self._problem.cost_of(self._best())
        new = [
            (h, self._about.get(id(h), sketch.problem).tolerance_columns)
            for effects, h in self._found.items()
            if h is not reduced.get(effects)
            and self._problem.cost_of(h) <= most
            and not self._is_idle(h)
        ]
        refined = {h.effects for h, _ in new if id(h) in self._about}
        self._found = known
        self._go_on_with(self._whole, none)
        for fitted in self._map(_on_all_rows, new):
            if fitted is not None:
                self._keep(fitted)
                if fitted.effects in refined:
                    self._refined.append(fitted)

    def _fit_history_dependent(self, cheap: Offered, best: float) -> None:
        problem, candidates = self._problem, self._problem.simulator.candidates
        expensive = self._offer([c for c in candidates if c.history_dependent], 0.5)
        screened = screen_singles(problem, expensive)
        best = min(best, self._least(screened))
        gap = excess(self._none.held_out_rmse**2, problem.floor)
        for one in screened:
            fitted = [excess(h.held_out_rmse**2, problem.floor) for h in self._found.values()]
            forecast = excess(one.placed.mean_square, problem.floor)
            if forecast <= min(_FAR_BEHIND * min(fitted, default=np.inf), _SLIGHTLY * gap):
                self._fit(promising(problem, [one], best), "history-dependent effects", 0.6)
        usual = self._unseen(screened, self._none)
        self._fit(usual, "history-dependent effects", 0.7)
        self._refine_best(1)
        left = min(h.held_out_rmse for h in (self._none, *self._found.values()))
        if self._is_resolved() or left <= _BARELY * problem.floor:
            return
        offered = {**cheap, **expensive}
        enough = _WORTH_PAIRING * problem.cost_of(self._best())
        pairs = [
            pair
            for pair in self._pairs(offered)
            if any(effect in expensive for effect in pair.effects)
            and problem.cost(pair.placed.mean_square, pair.placed.tolerance_chi2) < enough
        ]
        pairs = pairs[:_MOST_EXPENSIVE_PAIRS]
        alone = [h for h in self._found.values() if h.effects in {(name,) for name in expensive}]
        for single in sorted(alone, key=lambda h: h.held_out_rmse)[:2]:
            known = {pair.effects for pair in pairs}
            beside = screen_singles(problem, expensive, single)
            pairs += self._unseen([one for one in beside if one.effects not in known], single)
        self._fit(pairs, "pairs with history-dependent effects", 0.8)
        self._reselect_best(offered)
        present = self._best()
        beside = self._unseen(screen_singles(problem, expensive, present), present)
        self._fit(beside, "history-dependent effects beside the best", 0.85)
        for start in self._starts_with(expensive):
            if not self._is_resolved():
                self._select_jointly(expensive, start)

    def _unseen(self, screened: Sequence[Screened], without: Explanation) -> list[Screened]:
        """At a usual size those that were not fitted, where that alone improves on `without`.

        What sticks is far from linear, so that the simulator has the last word on it.
        """
        unseen = {one.effects: one for one in reversed(screened) if one.effects not in self._found}
        most_left = (_SLIGHTLY * without.held_out_rmse) ** 2
        return [at_usual_size(self._problem, one, most_left) for one in unseen.values()]

    def _starts_with(self, offered: Offered) -> list[Explanation]:
        """The best explanation, if these may help it, and else the best that has one of them."""
        best, cost_of = self._best(), self._problem.cost_of
        with_one = sorted(
            (h for h in self._found.values() if set(offered) & set(h.effects)), key=cost_of
        )
        if with_one and with_one[0] is best:
            return [best]
        most = min(_WORTH_GROWING * cost_of(best), _SLIGHTLY * cost_of(self._none))
        rivals = [h for h in with_one[:1] if cost_of(h) <= most]
        return [best, *rivals] if self._may_help(offered) else rivals

    def _may_help(self, offered: Offered) -> bool:
        """Whether the best explanation has one of these, or leaves what one may do."""
        problem = self._problem
        best = self._best()
        if set(offered) & set(best.effects):
            return True
        beside = screen_singles(problem, offered, best)[:1]
        left = [problem.cost(s.placed.mean_square, s.placed.tolerance_chi2) for s in beside]
        return min(left, default=np.inf) < _WORTH_PAIRING * problem.cost_of(best)

    def _starts(self, pairs: Collection[tuple[str, ...]]) -> list[Explanation]:
        """Of the pairs those that others may outdo only because nothing stands beside them yet."""
        cost_of = self._problem.cost_of
        fitted = sorted((h for e, h in self._found.items() if e in pairs), key=cost_of)
        singles = (cost_of(h) for h in self._found.values() if len(h.effects) == 1)
        most = min(
            _WORTH_GROWING * cost_of(self._best()), _WORTH_STARTING * min(singles, default=0.0)
        )
        return [h for h in fitted if cost_of(h) <= most][:_MOST_STARTS]

    def _select_jointly(self, known: Offered, start: Explanation) -> None:
        """From one explanation on; of `known` effects the columns are those offered."""
        candidates = [c for c in self._problem.simulator.candidates if not c.history_dependent]
        selection = JointSelection(self._problem, self._map, candidates, fit, known)
        for k, grown in enumerate(selection.run(start, self._is_explained, self._nearly)):
            self._progress("several effects at once", 0.3 + 0.02 * min(k, 10))
            self._keep(grown)
        self._refine(sorted(self._found.values(), key=self._problem.cost_of)[:1])

    def _replace(self) -> None:
        """Other effects in place of those of the best explanation, where that is quick."""
        candidates, best = self._problem.simulator.candidates, self._best()
        if best.effects and self._is_quick():
            for found in JointSelection(self._problem, self._map, candidates, fit, {}).replaced(
                best
            ):
                self._keep(found)
            self._refine(sorted(self._found.values(), key=self._problem.cost_of)[:_MOST_REPLACED])

    def _is_explained(self, explanation: Explanation) -> bool:
        """Whether it leaves what the sensors leave."""
        return self._problem.cost_of(explanation) <= 1.5 * excess(0.0, self._problem.floor)

    def _offer(self, candidates: Sequence[Candidate], done: float) -> Offered:
        offered = {}
        linear = self._map(linear_effects, candidates)
        for k, (candidate, shapes) in enumerate(zip(candidates, linear, strict=True)):
            self._progress(candidate.effect, done + 0.1 * k / len(candidates))
            offered[candidate.effect] = shapes
        return offered

    def _pairs(self, offered: Offered) -> list[Screened]:
        """Both effects at once, and a second one beside each of the two best; no two alike."""
        problem = self._problem
        singles = sorted(
            (h for h in self._found.values() if len(h.effects) == 1), key=problem.cost_of
        )
        least = min([self._none, *singles], key=lambda h: h.held_out_rmse).held_out_rmse
        screened = screen_pairs(problem, offered, least**2)
        for single in singles[:2]:
            screened += screen_singles(problem, offered, single)
        distinct: dict[tuple[str, ...], Screened] = {}
        for one in by_forecast(problem, screened):
            distinct.setdefault(one.effects, one)
        return [one for one in distinct.values() if one.effects not in self._found]

    def _fit(self, screened: Iterable[Screened], what: str, done: float) -> None:
        """Fits them; of the same effects the better is kept, among equals the less far-fetched."""
        screened = list(screened)
        for k, fitted in enumerate(self._fitted(screened)):
            self._progress(f"fitting {what}", done + 0.2 * k / len(screened))
            if fitted is not None:
                self._keep(fitted)

    def _fitted(self, screened: Sequence[Screened]) -> Iterator[Explanation | None]:
        """One by one in as many processes; a few expensive ones each in all processes."""
        expensive = self._history_dependent()
        if all(len(s.effects) == 1 and expensive.issuperset(s.effects) for s in screened):
            return (fit(self._spread, one) for one in screened)
        return self._map(fit, screened)

    def _keep(self, fitted: Explanation) -> None:
        known = self._found.get(fitted.effects)
        if known is not None:
            ratio = self._problem.cost_of(fitted) / self._problem.cost_of(known)
            if 1.0 / _ALIKE < ratio < _ALIKE:
                ratio = 0.0 if fitted.prior_distance < known.prior_distance else 1.0
            if ratio >= 1.0:
                return
        self._found[fitted.effects] = fitted

    def _reselect_best(self, offered: Offered) -> None:
        if not self._found:
            return
        best = min(self._found.values(), key=self._problem.cost_of)
        self._found[best.effects] = best = reselect_places(self._problem, best, offered)
        for alone in each_alone(self._problem, best):
            self._keep(alone)

    def _refine_best(self, most: int) -> None:
        """The best explanations with so many effects and fewer, as they compete in the end."""
        best: dict[int, Explanation] = {}
        for explanation in sorted(self._found.values(), key=self._problem.cost_of):
            best.setdefault(len(explanation.effects), explanation)
        self._refine([h for count, h in best.items() if count <= most])

    def _refine(self, rough: Iterable[Explanation]) -> None:
        done = {id(explanation) for explanation in self._refined}
        for one in rough:
            if id(one) not in done:
                fitted, about = final_refinement(self._spread, one)
                self._found[fitted.effects] = fitted
                self._refined.append(fitted)
                self._about[id(fitted)] = about

    def _leave_out(self) -> None:
        """The best explanation without each of its effects, down to what nothing can miss."""
        cost_of, history_dependent = self._problem.cost_of, self._history_dependent()
        best = self._best()
        if (
            self._whole.sketch
            and self._problem is self._whole
            and history_dependent & set(best.effects)
        ):
            return  # that was done on the sketch
        while len(best.effects) > 2:
            rests = left_out(self._map, best)
            for rest in rests:
                self._keep(rest)
            if self._is_quick():  # beside tolerances as apt as those of the best
                self._refine([self._found[rest.effects] for rest in rests])
            least = min((self._found[rest.effects] for rest in rests), key=cost_of)
            if cost_of(least) > _BORNE_OUT * cost_of(best) and self._shows(best, least):
                break
            best = least

    def _is_idle(self, explanation: Explanation) -> bool:
        """Whether fewer of its effects do about as well: the others have nothing to do."""
        fewer = [h for h in self._found.values() if set(h.effects) < set(explanation.effects)]
        cost = self._problem.cost_of(explanation)
        return any(
            self._problem.cost_of(h) < WORTH * cost or not self._shows(explanation, h)
            for h in fewer
        )

    def _shows(self, explanation: Explanation, rest: Explanation) -> bool:
        """Whether what an explanation has beside the rest of it is more than readings can show.

        Near the floor ratios of what is left grow large over nothing. It shows too where the
        rest makes up for it by a tolerance that is far off.
        """
        more = rest.held_out_rmse**2 - explanation.held_out_rmse**2
        strained = self._worst_tolerance(rest) > max(_FAR_OFF, self._worst_tolerance(explanation))
        return strained or more > (_LEAST_SHOWN * self._problem.floor) ** 2

    def _worst_tolerance(self, explanation: Explanation) -> float:
        """In standard deviations."""
        std = dict(zip(self._problem.tolerance_terms, self._problem.tolerance_std, strict=True))
        off = (abs(value) / std[term] for term, value in explanation.tolerances.items())
        return max(off, default=0.0)

    def _is_resolved(self) -> bool:
        """Whether something leaves so little that nothing more has anything to do."""
        return any(map(self._nearly, self._found.values()))

    def _nearly(self, explanation: Explanation) -> bool:
        gap = excess(self._none.held_out_rmse**2, self._problem.floor)
        little = self._problem.cost_of(explanation) <= _RESOLVED * gap
        return little or self._is_explained(explanation)

    def _is_quick(self) -> bool:
        """Whether nothing that is slow to simulate is offered."""
        return not self._history_dependent()

    def _history_dependent(self) -> set[str]:
        """Effects that depend on history; they are expensive to simulate."""
        return {c.effect for c in self._problem.simulator.candidates if c.history_dependent}

    def _least(self, screened: Iterable[Screened]) -> float:
        """The least excess that any of them leaves."""
        floor = self._problem.floor
        return min((excess(s.placed.mean_square, floor) for s in screened), default=float("inf"))


class _Spread:
    """A simulator whose variants are simulated in all processes of a pool."""

    def __init__(
        self, simulator: Simulator, spread: Callable[..., Iterator[Any]], most: int
    ) -> None:
        self.candidates, self.tolerances = simulator.candidates, simulator.tolerances
        self.floor = simulator.floor
        self._spread, self._most = spread, most

    def predict(self, variants: Sequence[Assignment]) -> Array:
        """As `Simulator.predict`."""
        share = -(-len(variants) // self._most)
        parts = [variants[k : k + share] for k in range(0, len(variants), share)]
        return np.concatenate(list(self._spread(_predicted, parts)))


def _on_whole(function: Callable[..., Any], problem: Problem, value: Any) -> Any:
    return function(problem, value)


def _on_sketch(function: Callable[..., Any], problem: Problem, value: Any) -> Any:
    assert problem.sketch is not None
    return function(problem.sketch.problem, value)


def _predicted(problem: Problem, variants: Sequence[Assignment]) -> Array:
    return problem.simulator.predict(variants)


def _on_all_rows(problem: Problem, found: tuple[Explanation, Array]) -> Explanation | None:
    """An explanation of the sketch, with the columns of tolerances that it was fitted beside."""
    explanation, tolerances = found
    sketch = problem.sketch
    assert sketch is not None
    about = replace(problem, tolerance_columns=sketch.over_all_rows(tolerances))
    predicted = problem.simulator.predict([explanation.values])[0]
    begun = predicted, sketch.over_all_rows(explanation.columns)
    return refit(about, explanation.values, 0, begun)
