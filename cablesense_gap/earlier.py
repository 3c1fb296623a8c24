"""The effects that an amended arm or robot lists, judged on a new recording.

They are the finding of an earlier diagnosis. They are fitted again together, and each is left out
once: it is needed if held-out trials are worse without it by more than chance.
"""

from __future__ import annotations

from collections.abc import Mapping

from cablesense_gap.diagnosis.fitting import refit
from cablesense_gap.diagnosis.problem import Hypothesis, Problem
from cablesense_gap.explained import fitted_number
from cablesense_gap.simulator import Assignment, Term, parameters_of
from cablesense_gap.verdict import Earlier
from cablesense_sim.effects.effect import WHOLE_ARM

_STEPS_WITH_ALL = 4
"""Gauss-Newton steps with all listed effects, which start at earlier numbers."""
_STEPS_WITHOUT = 2
"""Gauss-Newton steps without one of them, from the fit with all."""
_NEEDED_COST_RATIO = 1.08
"""Ratio of the costs without and with an effect from which on the effect is needed:
`EFFECT_WORTH`."""


def judged(problem: Problem, listed: Assignment) -> tuple[dict[Term, float], tuple[Earlier, ...]]:
    """The numbers of the listed effects that are needed, and a judgement of each listed effect.

    `problem` is that of the machine without them. The needed effects have the numbers that this
    recording gives them. Nothing is judged if they cannot be simulated under the recording.
    """
    fitted = refit(problem, listed, _STEPS_WITH_ALL)
    if fitted is None:
        return dict(listed), ()
    earlier = []
    kept = dict(fitted.values)
    for effect in sorted({term.effect for term in listed}):
        others = {t: v for t, v in fitted.values.items() if t.effect != effect}
        rest = refit(problem, others, _STEPS_WITHOUT)
        needed = rest is None or (
            problem.cost_of(rest) > _NEEDED_COST_RATIO * problem.cost_of(fitted)
            and fitted.is_clearly_better_than(rest)
        )
        if not needed:
            kept = {t: v for t, v in kept.items() if t.effect != effect}
        effect_values = {t: v for t, v in listed.items() if t.effect == effect}
        earlier.append(_judgement(problem, effect_values, fitted, needed=needed))
    return kept, tuple(earlier)


def _judgement(
    problem: Problem, listed: Mapping[Term, float], fitted: Hypothesis, *, needed: bool
) -> Earlier:
    """Earlier and present numbers of one effect."""
    known = parameters_of(problem.simulator.candidates)
    was = {}
    now = {}
    moved = False
    for term, value in listed.items():
        parameter = known[term]
        if parameter.past:
            continue
        name = term.parameter if term.place == WHOLE_ARM else f"{term.place}.{term.parameter}"
        present = fitted_number(parameter, fitted.values[term], fitted.deviations[term])
        was[name] = value
        now[name] = present
        if parameter.role == "size":
            moved |= not present.ci95[0] <= value <= present.ci95[1]
    places = dict.fromkeys(term.place for term in listed)
    return Earlier(
        effect=next(iter(listed)).effect,
        places=tuple(place for place in places if place != WHOLE_ARM),
        outcome="not needed" if not needed else "changed" if moved else "stands",
        was=was,
        now=now if needed else {},
    )
