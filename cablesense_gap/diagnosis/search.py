"""The search among candidates: what is cheap to simulate first, then what remembers.

Work on one course, shared among processes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from cablesense_base.workers import WorkerPool
from cablesense_gap.diagnosis.fitting import fit, polish, rethink, singled_out
from cablesense_gap.diagnosis.gauss_newton import refine
from cablesense_gap.diagnosis.places import WORTH, blocks
from cablesense_gap.diagnosis.problem import Course, Hypothesis, excess
from cablesense_gap.diagnosis.screening import (
    Look,
    Offered,
    by_forecast,
    joint_looks,
    promising,
    single_looks,
)
from cablesense_gap.simulator import Candidate

Tell = Callable[[str, float], None]

_MOST_SINGLES = 6
_MOST_PAIRS = 12
_MOST_DEAR_PAIRS = 4
_WORTH_PAIRING = 0.8
_RESOLVED = 0.04
_BARELY = 1.25
_ALIKE = 1.02


def search(course: Course, tell: Tell = lambda *_: None, workers: int = 1) -> list[Hypothesis]:
    """Every hypothesis that was fitted, that of tolerances alone first.

    Effects that remember are dear: they are left alone where one of the others, or two of them,
    leave next to nothing. `tell` hears what is under way and which share of the whole is behind.
    With more than one worker, candidates are looked at and fitted in as many processes.
    """
    none = refine(course, {}, [[]])
    assert none is not None
    with WorkerPool(workers, course) as pool:
        return [none, *_Search(course, pool, tell, none).run()]


class _Search:
    def __init__(self, course: Course, pool: WorkerPool, tell: Tell, none: Hypothesis) -> None:
        self._course, self._pool, self._tell, self._none = course, pool, tell, none
        self._found: dict[tuple[str, ...], Hypothesis] = {}
        self._polished: list[Hypothesis] = []

    def run(self) -> list[Hypothesis]:
        """The best hypothesis for every effect and every two that were fitted."""
        self._explore()
        self._polish(2)
        self._tell("done", 1.0)
        worth_it = [h for h in self._found.values() if not self._is_idle(h)]
        return sorted(worth_it, key=lambda h: (len(h.effects), h.held_out_rmse))

    def _explore(self) -> None:
        candidates = self._course.simulator.candidates
        barely = self._none.held_out_rmse <= _BARELY * self._course.floor
        plain = self._offer([c for c in candidates if not c.remembers], 0.0)
        looks = single_looks(self._course, plain)
        best = self._least(looks)
        self._fit(promising(self._course, looks[:_MOST_SINGLES], best), "single effects", 0.1)
        self._rethink_best(plain)
        if barely or self._is_resolved():
            return
        self._fit(self._pairs(plain, _MOST_PAIRS), "pairs of effects", 0.3)
        self._rethink_best(plain)
        if self._is_resolved():
            return
        dear = self._offer([c for c in candidates if c.remembers], 0.5)
        looks = single_looks(self._course, dear)
        best = min(best, self._least(looks))
        self._fit(promising(self._course, looks, best), "what remembers", 0.6)
        self._polish(1)
        if not self._is_resolved():
            self._fit(self._dear_pairs(plain, dear), "pairs with what remembers", 0.8)
            self._rethink_best({**plain, **dear})

    def _polish(self, most: int) -> None:
        """The best explanations with so many effects and fewer, as they compete in the end."""
        best: dict[int, Hypothesis] = {}
        for hypothesis in sorted(self._found.values(), key=self._course.cost_of):
            best.setdefault(len(hypothesis.effects), hypothesis)
        done = {id(hypothesis) for hypothesis in self._polished}
        rough = [h for count, h in best.items() if count <= most and id(h) not in done]
        for fitted in self._pool.map(polish, rough):
            self._found[fitted.effects] = fitted
            self._polished.append(fitted)

    def _is_idle(self, pair: Hypothesis) -> bool:
        """Whether one of two effects alone does about as well: the other has nothing to do."""
        alone = [h for h in map(self._found.get, zip(pair.effects)) if h and h is not pair]
        cost = self._course.cost_of(pair)
        return any(self._course.cost_of(h) < WORTH * cost for h in alone)

    def _offer(self, candidates: Sequence[Candidate], behind: float) -> Offered:
        offered = {}
        looked = self._pool.map(blocks, candidates)
        for k, (candidate, every) in enumerate(zip(candidates, looked, strict=True)):
            self._tell(candidate.effect, behind + 0.1 * k / len(candidates))
            offered[candidate.effect] = candidate, every
        return offered

    def _pairs(self, offered: Offered, most: int | None) -> list[Look]:
        """Both effects at once, and a second one beside each of the two best; no two alike."""
        course = self._course
        singles = sorted(
            (h for h in self._found.values() if len(h.effects) == 1), key=course.cost_of
        )
        least = min([self._none, *singles], key=lambda h: h.held_out_rmse).held_out_rmse
        looks = joint_looks(course, offered, least**2)
        for single in singles[:2]:
            looks += single_looks(course, offered, single)
        distinct: dict[tuple[str, ...], Look] = {}
        for look in by_forecast(course, looks):
            distinct.setdefault(look.effects, look)
        return [look for look in distinct.values() if look.effects not in self._found][:most]

    def _dear_pairs(self, plain: Offered, dear: Offered) -> list[Look]:
        """Pairs with an effect that remembers, if they promise more than what is found."""
        enough = _WORTH_PAIRING * min(
            self._course.cost_of(h) for h in [self._none, *self._found.values()]
        )
        return [
            look
            for look in self._pairs({**plain, **dear}, None)
            if any(effect in dear for effect in look.effects)
            and self._course.cost(look.placed.mean_square, look.placed.strain) < enough
        ][:_MOST_DEAR_PAIRS]

    def _rethink_best(self, offered: Offered) -> None:
        if not self._found:
            return
        best = min(self._found.values(), key=self._course.cost_of)
        self._found[best.effects] = best = rethink(self._course, best, offered)
        for alone in singled_out(self._course, best):
            self._keep(alone)

    def _fit(self, looks: Iterable[Look], what: str, behind: float) -> None:
        """Fits them; of the same effects the better is kept, among equals the less far-fetched."""
        looks = list(looks)
        for k, fitted in enumerate(self._pool.map(fit, looks)):
            self._tell(f"fitting {what}", behind + 0.2 * k / len(looks))
            if fitted is not None:
                self._keep(fitted)

    def _keep(self, fitted: Hypothesis) -> None:
        known = self._found.get(fitted.effects)
        if known is None or self._is_better(fitted, known):
            self._found[fitted.effects] = fitted

    def _least(self, looks: Iterable[Look]) -> float:
        """The least excess that any look leaves."""
        floor = self._course.floor
        return min((excess(k.placed.mean_square, floor) for k in looks), default=float("inf"))

    def _is_resolved(self) -> bool:
        """Whether something leaves so little that nothing more has anything to do."""
        floor = self._course.floor
        gap = excess(self._none.held_out_rmse**2, floor)
        best = min(map(self._course.cost_of, self._found.values()), default=float("inf"))
        return best <= max(_RESOLVED * gap, 1.5 * excess(0.0, floor))

    def _is_better(self, one: Hypothesis, other: Hypothesis) -> bool:
        ratio = self._course.cost_of(one) / self._course.cost_of(other)
        if 1.0 / _ALIKE < ratio < _ALIKE:
            return one.strangeness < other.strangeness
        return ratio < 1.0
