"""The search for hypotheses: effects and places are added, removed and exchanged.

A hypothesis is expanded by scoring additions to it linearly (`selection`); the simulator then
fits the best few (`fitting`). The best hypothesis that has not been expanded comes next.
History-dependent effects are expensive to simulate. They are tried where the others leave
something unexplained that the past may cause, first on a part of the rows if the problem has a
subsample.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, combinations, product
from typing import Any

import numpy as np

from cablesense_base.workers import WorkerPool
from cablesense_gap.diagnosis.duration import (
    COMPARING_ENDS,
    WITH_MEMORY_ENDS,
    WITHOUT_MEMORY_ENDS,
    may_depend_on_history,
)
from cablesense_gap.diagnosis.fitting import MOST_STEPS, fit, refine, refit, refitted, without
from cablesense_gap.diagnosis.nuisance import final_refinement, with_nuisance_at
from cablesense_gap.diagnosis.problem import Hypothesis, Problem, noise_corrected_rms
from cablesense_gap.diagnosis.selection import (
    LinearEffect,
    Proposal,
    Selection,
    linear_effects,
    own_columns,
)
from cablesense_gap.simulator import Candidate, Term
from cablesense_sim.effects.effect import WHOLE_ARM

Progress = Callable[[str, float], None]
"""Called with the present step and the share of the whole that is done."""

_MOST_EXPANDED = 8
"""Hypotheses that are expanded at most, to bound the time: with none and up to seven effects."""
_MOST_FRUITLESS = 2
"""Hypotheses that are expanded in turn without a better one: two effects may be worth it only
together."""
_FITTED_ADDITIONS = 3
"""Additions to one hypothesis that are fitted: the linear score often errs by a rank or two."""
_ROUGH_STEPS = 3
"""Gauss-Newton steps by which effects that imitate each other are compared before a full fit."""
_RIVAL_COST_RATIO = 2.0
"""A hypothesis may still become the best if its cost is at most this many times the least."""
_SUBSAMPLE_RIVAL_COST_RATIO = 6.0
"""The same on a part of the rows, which all rows may rank otherwise."""
_IMPROVED_COST_RATIO = 0.95
"""A cost above this share of another one is no better: other folds would change it as much."""
_REDUNDANT_COST_RATIO = 1.12
"""A hypothesis is redundant if fewer of its effects cost less than this many times as much."""
_RESOLVED_FLOOR_RATIO = 1.1
"""Noise floors up to which the residual of nuisance parameters alone leaves nothing to explain."""
_RESOLVED_GAP_SHARE = 0.03
"""Share of the gap that a hypothesis may leave before no further effect is worth its time."""
_PROGRESS_SHARE = 0.35
"""Share of the rest of a phase that each batch of work counts for, as their number is open."""


def search(
    problem: Problem, progress: Progress = lambda *_: None, workers: int = 1
) -> list[Hypothesis]:
    """Every hypothesis that was fitted and is worth its effects, nuisance parameters alone first.

    With more than one worker, candidates are simulated and fitted in as many processes.
    """
    without_effects = refine(problem, {}, [[]])
    assert without_effects is not None
    with WorkerPool(workers, problem) as pool:
        return [without_effects, *_Search(problem, pool, progress, without_effects).run()]


class _Search:
    """The hypotheses that were found, on all rows of a problem or on those of its subsample."""

    def __init__(
        self, problem: Problem, pool: WorkerPool, progress: Progress, none: Hypothesis
    ) -> None:
        self._whole = problem
        self._problem = problem
        self._none = none
        self._pool = pool
        self._progress = progress
        self._doing = ""
        self._done = 0.0
        self._until = WITHOUT_MEMORY_ENDS
        candidates = problem.simulator.candidates
        self._memoryless = [c for c in candidates if not c.history_dependent]
        self._history_dependent = [c for c in candidates if c.history_dependent]
        self._history = {c.effect for c in self._history_dependent}
        self._fitted_by_effects: dict[tuple[str, ...], Hypothesis] = {}
        self._expanded: set[frozenset[tuple[str, str]]] = set()
        self._refined: set[Hypothesis] = set()
        self._fitted_in: dict[Hypothesis, Problem] = {}

    def _map(
        self,
        function: Callable[..., Any],
        values: Iterable[Any],
        name: Callable[[Any], str] | None = None,
    ) -> Iterator[Any]:
        """Results of a function of the present problem and each value, from all processes.

        Progress shows the value's `name`, if that is given.
        """
        subsample = self._whole.subsample
        tasks = tuple(values)
        on_subsample = subsample is not None and self._problem is subsample.problem
        other = None if on_subsample or self._problem is self._whole else self._problem
        results = self._pool.map(partial(_call_on_problem, function, on_subsample, other), tasks)
        done_before = self._done
        share = _PROGRESS_SHARE * (self._until - self._done)
        for k, task in enumerate(tasks, 1):
            self._doing = name(task) if name else self._doing
            self._progress(self._doing, self._done)
            yield next(results)
            self._done = done_before + share * k / len(tasks)

    def run(self) -> list[Hypothesis]:
        """The best hypothesis for every set of effects that is worth it."""
        self._nominal = self._columns(self._memoryless, self._none)
        self._expand(self._none, self._nominal)
        if not self._is_resolved():
            self._take_search_steps([])
        if not self._history_dependent:
            self._exchange_best()
        elif not self._is_explained() and self._may_depend_on_history():
            self._add_history_dependent()
        self._compare()
        self._progress("done", 1.0)
        worth_it = [h for h in self._fitted_by_effects.values() if not self._is_redundant(h)]
        return sorted(worth_it, key=lambda h: (len(h.effects), h.held_out_rmse))

    def _take_search_steps(self, known: Sequence[LinearEffect]) -> None:
        """Expands the best hypotheses.

        `known` columns serve as they are: those of history-dependent effects, which are tried
        where the gap is nearly resolved, too, as they may be what an imitation leaves.
        """
        score = self._problem.score
        fruitless = 0
        for _ in range(_MOST_EXPANDED):
            if self._best().effects:
                self._refine([self._best()])
            self._refine_history()
            best = self._best()
            start = self._next(worth_it=not known)
            resolved = self._is_explained() if known else self._is_resolved()
            if start is None or fruitless == _MOST_FRUITLESS or self._problem.is_explained(best):
                break
            if resolved and start is not best:
                break
            if known:  # with nuisance parameters as apt as those of the best
                self._refine([start])
                start = self._fitted_by_effects[start.effects]
            columns = [*known, *self._columns(self._memoryless, start)]
            self._expand(start, columns)
            if self._best() is best is start and not resolved:
                self._exchange(best, columns, _FITTED_ADDITIONS)
            fruitless = (
                0 if score(self._best()) < _IMPROVED_COST_RATIO * score(best) else fruitless + 1
            )

    def _next(self, worth_it: bool) -> Hypothesis | None:
        """The best that was not expanded, unless the best of all has all its effects and more.

        `worth_it`: only if it is better than none. Each of four equal effects explains 13 % of the
        residual, less than its penalty: where the past may act, no single effect need be worth it.
        """
        best = self._best()
        score = self._problem.score
        most = min(_RIVAL_COST_RATIO * score(best), score(self._none) if worth_it else np.inf)
        waiting = [
            h
            for h in self._fitted_by_effects.values()
            if frozenset(h.locations) not in self._expanded
            and score(h) <= most
            and not set(h.effects) < set(best.effects)
        ]
        return min(waiting, key=score, default=None)

    def _columns(
        self, candidates: Sequence[Candidate], about: Hypothesis | None
    ) -> list[LinearEffect]:
        """Columns of each candidate in each place, linear about a hypothesis."""
        linear = partial(linear_effects, about=about)
        return list(chain.from_iterable(self._map(linear, candidates, lambda c: c.effect)))

    def _expand(self, start: Hypothesis, columns: Sequence[LinearEffect]) -> None:
        """Fits the most promising additions, and the hypothesis without each redundant effect."""
        self._expanded.add(frozenset(start.locations))
        if offered := _compatible_columns(start, columns):
            self._progress("choosing effects", self._done)
            proposals = Selection(self._problem, start, offered).additions()
            self._done += _PROGRESS_SHARE * (self._until - self._done)
            usual = self._at_typical_size(proposals, start)
            if start.effects:
                self._fit([*self._promising(proposals), *usual])
            else:
                self._fit_by_count(proposals, usual)
        if len(start.effects) > 1:
            own_effects = Selection(self._problem, *own_columns(self._problem, start))
            most = _RIVAL_COST_RATIO * self._problem.cost_of(start)
            redundant = [(e,) for e in start.effects if own_effects.left_without(e) < most]
            self._keep_better(self._without(start, redundant))

    def _fit_by_count(self, proposals: Sequence[Proposal], usual: Sequence[Proposal]) -> None:
        """The most promising with one effect, and with two and more if those explain too little.

        The posterior weighs all of them.
        """
        one, two, more = (
            [p for p in proposals if count == min(len(p.effects), 3)] for count in (1, 2, 3)
        )
        self._fit([*self._promising(one, 2 * _FITTED_ADDITIONS), *usual])
        self._refine_history()
        if not self._is_resolved():
            self._fit([*self._promising(two, _FITTED_ADDITIONS + 1), *self._promising(more)])

    def _promising(
        self, proposals: Sequence[Proposal], most: int = _FITTED_ADDITIONS
    ) -> list[Proposal]:
        least = min((p.forecast for p in proposals), default=0.0)
        return [p for p in proposals if p.forecast <= _RIVAL_COST_RATIO * least][:most]

    def _at_typical_size(self, proposals: Sequence[Proposal], start: Hypothesis) -> list[Proposal]:
        """Every history-dependent effect that was not fitted: it is far from linear."""
        most_left = (_IMPROVED_COST_RATIO * start.held_out_rmse) ** 2
        ranges = self._problem.parameters
        usual = []
        for p in proposals:
            new = set(p.effects) - set(start.effects)
            if len(new) == 1 and new <= self._history and p.effects not in self._fitted_by_effects:
                first = p.added[0]
                sizes = np.array([float(ranges[term].role == "size") for term in first.varied])
                usual.append(replace(p, added=(first,), coefficients=sizes, most_left=most_left))
        return usual

    def _fit(self, proposals: Sequence[Proposal]) -> None:
        for fitted in self._map(fit, proposals, lambda p: " + ".join(p.effects)):
            self._keep_better(fitted)

    def _keep_better(self, hypotheses: Iterable[Hypothesis]) -> None:
        """Keeps the better of two hypotheses with the same effects."""
        for hypothesis in hypotheses:
            known = self._fitted_by_effects.get(hypothesis.effects, self._none)
            if hypothesis.effects and (
                not known.effects or self._problem.score(hypothesis) < self._problem.score(known)
            ):
                self._fitted_by_effects[hypothesis.effects] = hypothesis
                self._fitted_in[hypothesis] = self._problem

    def _without(
        self, hypothesis: Hypothesis, gone: Iterable[tuple[str, ...]]
    ) -> list[Hypothesis]:
        """The hypothesis without each of some sets of effects, fitted again."""
        rests = self._map(partial(without, hypothesis=hypothesis), gone)
        return [h for h in rests if h is not None]

    def _exchange(
        self, hypothesis: Hypothesis, columns: Sequence[LinearEffect], most: int, out: int = 1
    ) -> None:
        """Puts one other effect in place of one, or of up to `out`, that a hypothesis has."""
        gone = chain(*(combinations(hypothesis.effects, n + 1) for n in range(out)))
        others = [e for e in columns if e.effect not in hypothesis.effects]
        rests = self._without(hypothesis, gone)
        self._keep_better(rests)
        proposals = chain(
            *(Selection(self._problem, r, others).singles() for r in rests if others)
        )
        self._fit(sorted(proposals, key=lambda p: p.forecast)[:most])

    def _exchange_best(self) -> None:
        """Exchanges effects of the best hypothesis until that no longer helps.

        The columns are linear about the nominal mechanism: next to the effect that it replaces,
        as a mass next to a shifted centre, an effect would change nothing.
        """
        for _ in range(_MOST_EXPANDED):
            best = self._best()
            self._exchange(best, self._nominal, 2 * _FITTED_ADDITIONS, out=2)
            self._exchange_alike(best)
            if self._problem.score(self._best()) >= _IMPROVED_COST_RATIO * self._problem.score(
                best
            ):
                break

    def _exchange_alike(self, hypothesis: Hypothesis) -> None:
        """Puts another effect in the places of one or two that have the same choice of places.

        Such effects imitate each other (a mass, a shifted centre and a payload change the same ten
        numbers of a link), often where the other is far from linear: all are fitted a little, in
        all of these places and in each alone.
        """
        candidates = {c.effect: c for c in self._problem.simulator.candidates}
        variants = []
        for gone in chain(*(combinations(hypothesis.effects, n) for n in (1, 2))):
            offered = {candidates[effect].places for effect in gone}
            gone_places = list(
                dict.fromkeys(p for effect, p in hypothesis.locations if effect in gone)
            )
            tried = (
                [gone_places]
                if len(gone_places) == 1
                else [gone_places, *([place] for place in gone_places)]
            )
            rest = {t: v for t, v in hypothesis.values.items() if t.effect not in gone}
            variants += [
                rest
                | {
                    Term(c.effect, new_place, p.name): p.default
                    for new_place in places
                    for p in c.parameters
                }
                for c in self._memoryless
                for places in tried
                if offered == {c.places} and c.effect not in hypothesis.effects
            ]
        rough = filter(None, self._map(partial(refit, most_steps=_ROUGH_STEPS), variants))
        best = sorted(rough, key=self._problem.score)[:_FITTED_ADDITIONS]
        for fitted in self._map(refitted, best):
            self._keep_better(fitted)

    def _add_history_dependent(self) -> None:
        """Continues with history-dependent effects on the subsample; all rows score results."""
        subsample = self._whole.subsample
        self._until = WITH_MEMORY_ENDS
        if subsample is None:
            self._take_search_steps_with_history()
            self._problem = self._whole
            return
        without_effects = self._none
        known = self._fitted_by_effects
        nominal = self._nominal
        reduced = {effects: subsample.hypothesis(h) for effects, h in known.items()}
        self._fitted_by_effects = dict(reduced)
        self._problem = subsample.problem
        self._none = subsample.hypothesis(without_effects)
        self._take_search_steps_with_history()
        self._compare()
        self._doing = "judging on all rows"
        most = _SUBSAMPLE_RIVAL_COST_RATIO * self._problem.cost_of(self._best())
        new = [
            (h, self._fitted_in[h])
            for effects, h in self._fitted_by_effects.items()
            if h is not reduced.get(effects)
            and self._problem.cost_of(h) <= most
            and not self._is_redundant(h)
        ]
        self._fitted_by_effects = known
        self._nominal = nominal
        self._problem = self._whole
        self._none = without_effects
        on_all_rows = [h for h in self._map(_on_all_rows, new) if h is not None]
        self._keep_better(on_all_rows)
        self._refined.update(on_all_rows)

    def _take_search_steps_with_history(self) -> None:
        self._expanded.clear()
        columns = self._columns(self._history_dependent, None)
        self._expand(self._none, columns)
        best = min(self._fitted_by_effects.values(), key=self._problem.score, default=self._none)
        if best.effects and not self._is_resolved():
            self._expand(best, [*columns, *self._columns(self._memoryless, best)])
        self._take_search_steps(columns)

    def _compare(self) -> None:
        """Refines the best hypotheses, and the best without each of its effects."""
        self._until = COMPARING_ENDS
        self._refine_best()
        self._try_other_shapes(self._best())
        self._refine([self._best()])
        best = self._best()
        cost_of = self._problem.cost_of
        while len(best.effects) > 1:
            if self._problem.subsample and self._history & set(best.effects):
                break  # this was done on the subsample
            rests = self._without(best, [(e,) for e in best.effects])
            self._keep_better(rests)
            # with nuisance parameters as apt as those of the best
            self._refine(
                self._without_history(self._fitted_by_effects[rest.effects] for rest in rests)
            )
            least = min(
                (self._fitted_by_effects[rest.effects] for rest in rests),
                key=cost_of,
                default=best,
            )
            if least is best or (
                cost_of(least) > _RIVAL_COST_RATIO * cost_of(best)
                and self._problem.shows(best, least)
            ):
                break
            best = least
        self._refine_best()

    def _try_other_shapes(self, hypothesis: Hypothesis) -> None:
        """Fits a hypothesis again from all starts of its effects' shapes.

        Between one filter and another of the same delay, as between other shapes, no small step
        may lead to less.
        """
        variants = []
        for candidate in self._memoryless:
            shapes = [p for p in candidate.parameters if p.role == "shape" and len(p.starts) > 1]
            places = [
                place for effect, place in hypothesis.locations if effect == candidate.effect
            ]
            if not (shapes and places):
                continue
            for starts in product(*(shape.starts for shape in shapes)):
                given = {
                    Term(candidate.effect, place, shape.name): start
                    for place in places
                    for shape, start in zip(shapes, starts, strict=True)
                }
                variants.append(dict(hypothesis.values) | given)
        for fitted in self._map(partial(refit, most_steps=MOST_STEPS), variants):
            self._keep_better([fitted] if fitted is not None else [])

    def _refine_best(self) -> None:
        """The rivals of the best, and the best with one effect and with two."""
        score = self._problem.score
        ranked = sorted(self._fitted_by_effects.values(), key=score)
        rivals = [h for h in ranked if score(h) <= _RIVAL_COST_RATIO * score(ranked[0])]
        one, two = ([h for h in ranked if len(h.effects) == count][:1] for count in (1, 2))
        self._refine(
            [*rivals[:1], *self._without_history(rivals)[: 2 * _FITTED_ADDITIONS], *one, *two]
        )

    def _without_history(self, hypotheses: Iterable[Hypothesis]) -> list[Hypothesis]:
        """Those without a history-dependent effect."""
        return [h for h in hypotheses if not self._history & set(h.effects)]

    def _refine_history(self) -> None:
        """Refines the best if it depends on history; later fits use its nuisance parameters.

        Friction changes the columns of nuisance parameters.
        """
        if self._history & set(self._best().effects):
            self._refine([self._best()])
            self._problem = self._fitted_in[self._best()]

    def _refine(self, rough: Iterable[Hypothesis]) -> None:
        waiting = dict.fromkeys(
            hypothesis for hypothesis in rough if hypothesis not in self._refined
        )
        for fitted, nuisance in self._map(final_refinement, waiting):
            self._fitted_by_effects[fitted.effects] = fitted
            self._fitted_in[fitted] = nuisance
            self._refined.add(fitted)

    def _best(self) -> Hypothesis:
        return min([self._none, *self._fitted_by_effects.values()], key=self._problem.score)

    def _is_redundant(self, hypothesis: Hypothesis) -> bool:
        return is_redundant(self._problem, hypothesis, self._fitted_by_effects.values())

    def _may_depend_on_history(self) -> bool:
        """Whether history-dependent effects may cause the residual of the best hypothesis."""
        best = min((self._none, *self._fitted_by_effects.values()), key=lambda h: h.held_out_rmse)
        return may_depend_on_history(self._problem, best.held_out)

    def _is_resolved(self) -> bool:
        """Whether so little is unexplained that no further effect is worth its time.

        Nuisance parameters alone leave little more than the floor, or a hypothesis little of the
        gap.
        """
        gap = noise_corrected_rms(self._none.held_out_rmse**2, self._problem.floor)
        little = _RESOLVED_GAP_SHARE * gap
        return self._is_explained() or any(
            self._problem.cost_of(h) <= little for h in self._fitted_by_effects.values()
        )

    def _is_explained(self) -> bool:
        """Whether nuisance parameters alone, or a hypothesis, leave little more than the floor.

        A large gap may be nearly resolved and still hide an effect of the past that is far above
        the floor.
        """
        problem = self._problem
        near = _RESOLVED_FLOOR_RATIO * problem.floor
        if self._none.held_out_rmse <= near and problem.has_usual_nuisance(self._none):
            return True
        return any(problem.is_explained(h) for h in self._fitted_by_effects.values())


def is_redundant(problem: Problem, hypothesis: Hypothesis, others: Iterable[Hypothesis]) -> bool:
    """Whether one of the others, with fewer of its effects, does about as well."""
    fewer = [h for h in others if set(h.effects) < set(hypothesis.effects)]
    cost = problem.cost_of(hypothesis)
    return any(
        problem.cost_of(h) < _REDUNDANT_COST_RATIO * cost or not problem.shows(hypothesis, h)
        for h in fewer
    )


def _compatible_columns(start: Hypothesis, columns: Sequence[LinearEffect]) -> list[LinearEffect]:
    """Sites that a hypothesis may have in addition: no effect both everywhere and in places."""
    whole = {effect for effect, place in start.locations if place == WHOLE_ARM}
    return [
        e
        for e in columns
        if e.effect not in whole
        and (e.effect, e.place) not in start.locations
        and not (e.place == WHOLE_ARM and e.effect in start.effects)
    ]


def _call_on_problem(
    function: Callable[..., Any],
    on_subsample: bool,
    other: Problem | None,
    problem: Problem,
    value: Any,
) -> Any:
    """The function of the problem that processes have, of its subsample, or of another one."""
    if other is not None:
        return function(other, value)
    if on_subsample:
        assert problem.subsample is not None
        problem = problem.subsample.problem
    return function(problem, value)


def _on_all_rows(problem: Problem, found: tuple[Hypothesis, Problem]) -> Hypothesis | None:
    """A hypothesis of the subsample, with the nuisance parameters in its fit."""
    hypothesis, of_subsample = found
    subsample = problem.subsample
    assert subsample is not None
    with_fitted = problem
    if of_subsample.nuisance_at != problem.nuisance_at:
        columns = subsample.over_all_rows(of_subsample.nuisance_columns)
        with_fitted = with_nuisance_at(problem, of_subsample.nuisance_at, columns)
    predicted = with_fitted.predict([hypothesis.values])[0]
    start = predicted, subsample.over_all_rows(hypothesis.columns)
    return refit(with_fitted, hypothesis.values, 0, start)
