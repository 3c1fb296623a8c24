"""From what screening finds to numbers that the simulator itself fits, and places chosen again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product

from cablesense_gap.diagnosis.gauss_newton import refine, refit, refit_part
from cablesense_gap.diagnosis.places import WORTH
from cablesense_gap.diagnosis.problem import Explanation, Problem, to_scaled
from cablesense_gap.diagnosis.screening import Offered, Screened, screen_singles
from cablesense_gap.simulator import Candidate, Term, parameters_of
from cablesense_sim.effects.effect import Parameter

_STEPS, _STEPS_OF_EXPENSIVE, _STEPS_AGAIN = 8, 4, 4
_SCALES = (0.4, 1.0, 2.5)
_SCALES_ELSEWHERE = (0.3, 1.0, 3.0, 10.0)
"""In typical sizes, where screening has found a size that cannot be."""
_ROUNDS = 2


def fit(problem: Problem, screened: Screened) -> Explanation | None:
    """The effects as the simulator has them; None where that leads nowhere.

    A history-dependent effect is begun with smaller and larger sizes too, and with every
    combination of the shapes that screening does not distinguish.
    """
    candidates = {c.effect: c for c in problem.simulator.candidates}
    with_history = [
        candidates[effect] for effect in screened.effects if candidates[effect].history_dependent
    ]
    ranges, beside = parameters_of(problem.simulator.candidates), screened.beside
    known = {} if beside is None else dict(beside.values)
    begun = [to_scaled(ranges[term], value) for term, value in known.items()]
    start, impossible = _starts(screened, ranges)
    own = {candidate.effect for candidate in with_history}

    def varied(scale: float, shapes: Mapping[tuple[str, str], float]) -> list[float]:
        """Of history-dependent effects the sizes scaled, the shapes put in."""
        return [
            value
            if term.effect not in own
            else max(abs(value), 0.1) * scale
            if ranges[term].role == "size"
            else shapes.get((term.effect, term.parameter), value)
            for term, value in start.items()
        ]

    starts = [[*begun, *start.values()]]
    if beside is None:
        scales = _SCALES if with_history else (1.0,)
        starts = [varied(scale, shapes) for scale in scales for shapes in _shapes(with_history)]
    if impossible:
        # where shapes act unlike their derivatives, the screening's best sum of both means nothing
        for scale in _SCALES_ELSEWHERE:
            elsewhere = {
                t: scale if ranges[t].role == "size" else v for t, v in impossible.items()
            }
            starts.append([*begun, *(start | elsewhere).values()])
    return refine(
        problem,
        {term: ranges[term] for term in (*known, *start)},
        starts,
        _STEPS_OF_EXPENSIVE if with_history else _STEPS,
        screened.most_left if with_history else float("inf"),
    )


def _starts(
    screened: Screened, ranges: Mapping[Term, Parameter]
) -> tuple[dict[Term, float], dict[Term, float]]:
    """Scaled values to begin at, and others for those of places with a size out of range."""
    start: dict[Term, float] = {}
    impossible: dict[Term, float] = {}
    coefficients = iter(screened.placed.coefficients)
    for effect in screened.placed.chosen:
        change = {name: next(coefficients) for name in effect.probed}
        sizes = [ranges[term] for term in effect.terms if ranges[term].role == "size"]
        first = max(abs(change[sizes[0].name]), 0.3)
        for term, begin in zip(effect.terms, effect.start, strict=True):
            # sizes as screened; shapes from what screening adds beside a size of one
            added = change.get(term.parameter, 0.0)
            start[term] = added if ranges[term].role == "size" else begin + added / first
        low_high = [(to_scaled(p, p.low), to_scaled(p, p.high)) for p in sizes]
        if any(
            not low <= change[p.name] <= high
            for p, (low, high) in zip(sizes, low_high, strict=True)
        ):
            impossible |= dict(zip(effect.terms, effect.start, strict=True))
    return start, impossible


def _shapes(with_history: Sequence[Candidate]) -> list[dict[tuple[str, str], float]]:
    """Combinations of the shapes that screening has not distinguished, of one effect at a time."""
    combinations: list[dict[tuple[str, str], float]] = []
    for candidate in with_history:
        shapes = [p for p in candidate.parameters if p.role == "shape" and p.trials]
        combinations += [
            {
                (candidate.effect, p.name): to_scaled(p, value)
                for p, value in zip(shapes, values, strict=True)
            }
            for values in product(*(p.trials for p in shapes))
        ]
    return combinations or [{}]


def reselect_places(problem: Problem, explanation: Explanation, offered: Offered) -> Explanation:
    """The explanation with the places of each of two effects chosen again beside the other.

    They were chosen linear about the nominal mechanism, and beside effects that were not there
    yet. Of equal explanations the one with fewer places is given.
    """
    for _ in range(_ROUNDS):
        better = explanation
        for screened in _again(problem, explanation, offered):
            fitted = fit(problem, screened)
            if fitted is not None and problem.cost_of(fitted) < problem.cost_of(better):
                better = fitted
        if better is explanation:
            break
        explanation = better
    return _fewest_places(problem, explanation)


def _again(problem: Problem, explanation: Explanation, offered: Offered) -> Iterator[Screened]:
    if len(explanation.effects) < 2:
        return
    for effect in explanation.effects:
        others = {t: v for t, v in explanation.values.items() if t.effect != effect}
        beside = refit(problem, others, 0)
        if beside is None or effect not in offered:
            continue
        for screened in screen_singles(problem, {effect: offered[effect]}, beside):
            placed = {linear.place for linear in screened.placed.chosen}
            if placed != {t.place for t in explanation.values if t.effect == effect}:
                yield screened


def _fewest_places(problem: Problem, explanation: Explanation) -> Explanation:
    """Places are left out as long as what is left hardly grows."""
    sites = list(dict.fromkeys((term.effect, term.place) for term in explanation.values))
    cost = problem.cost_of(explanation)
    for effect, place in reversed(sites):
        if sum(e == effect for e, _ in sites) == 1:
            continue
        rest = {t: v for t, v in explanation.values.items() if t[:2] != (effect, place)}
        fitted = refit_part(problem, explanation, rest, _STEPS_AGAIN)
        if fitted is not None and problem.cost_of(fitted) <= WORTH * cost:
            explanation = fitted
            sites.remove((effect, place))
    return explanation


def each_alone(problem: Problem, explanation: Explanation) -> Iterator[Explanation]:
    """Each of two effects alone, begun with its numbers beside the other.

    A search for one effect may end early where a second one then makes up for it.
    """
    if len(explanation.effects) < 2:
        return
    for effect in explanation.effects:
        own = {t: v for t, v in explanation.values.items() if t.effect == effect}
        if (fitted := refit_part(problem, explanation, own, _STEPS_AGAIN)) is not None:
            yield fitted
