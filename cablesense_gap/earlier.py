"""What an arm file lists already, judged on a new recording: the finding of an earlier diagnosis.

Its effects are fitted again together, and each is left out once: it still has a place where
held-out trials are worse without it by more than chance. The diagnosis then goes on from what
stands, with the numbers and the past of this recording.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from cablesense_gap.arm_simulator import amended_arm
from cablesense_gap.diagnosis.gauss_newton import refit
from cablesense_gap.diagnosis.joint_selection import borne_out
from cablesense_gap.diagnosis.problem import Explanation, Problem
from cablesense_gap.simulator import Term, parameters_of
from cablesense_gap.verdict import Earlier, FittedNumber
from cablesense_sim.arm import Arm
from cablesense_sim.effects.effect import WHOLE_ARM
from cablesense_sim.effects.registry import known_effects

_STEPS, _STEPS_WITHOUT = 4, 2
_WORSE = 1.08
"""Cost without an effect over that with it, from which on the effect is needed."""


class GoingOn(NamedTuple):
    """Where a diagnosis goes on from.

    Attributes:
        arm: with the effects that stand, their numbers as this recording has them.
        earlier: of each effect that the arm file listed, in alphabetical order.
    """

    arm: Arm
    earlier: tuple[Earlier, ...]


def listed_values(arm: Arm) -> dict[Term, float]:
    """The numbers of the effects that an arm file lists, tolerances left out."""
    return {
        Term(listed.effect, listed.at, name): value
        for listed in arm.effects
        if not known_effects()[listed.effect].tolerance
        for name, value in listed.parameters.items()
    }


def without_effects(arm: Arm) -> Arm:
    """The arm with its tolerances alone."""
    kept = [e for e in arm.effects if known_effects()[e.effect].tolerance]
    return arm.model_copy(update={"effects": kept})


def going_on(problem: Problem, arm: Arm) -> GoingOn:
    """What of an arm's effects stands; `problem` is that of `without_effects` of the arm.

    Where these effects cannot be simulated under the recording, the arm stays as it is.
    """
    listed = listed_values(arm)
    fitted = refit(problem, listed, _STEPS)
    if fitted is None:
        return GoingOn(arm, ())
    earlier, kept = [], dict(fitted.values)
    for effect in sorted({term.effect for term in listed}):
        others = {t: v for t, v in fitted.values.items() if t.effect != effect}
        rest = refit(problem, others, _STEPS_WITHOUT)
        needed = rest is None or _is_needed(problem, fitted, rest)
        if not needed:
            kept = {t: v for t, v in kept.items() if t.effect != effect}
        earlier.append(_judged(problem, effect, listed, fitted, needed=needed))
    return GoingOn(amended_arm(without_effects(arm), kept, {}), tuple(earlier))


def _is_needed(problem: Problem, fitted: Explanation, rest: Explanation) -> bool:
    worse = problem.cost_of(rest) > _WORSE * problem.cost_of(fitted)
    return worse and borne_out(fitted, rest)


def _judged(
    problem: Problem,
    effect: str,
    listed: Mapping[Term, float],
    fitted: Explanation,
    *,
    needed: bool,
) -> Earlier:
    known = parameters_of(problem.simulator.candidates)
    was, now, moved = {}, {}, False
    for term, value in listed.items():
        parameter = known[term]
        if term.effect != effect or parameter.past:
            continue
        name = term.parameter if term.place == WHOLE_ARM else f"{term.place}.{term.parameter}"
        found, half = fitted.values[term], fitted.deviations[term]
        interval = max(found - half, parameter.low), min(found + half, parameter.high)
        was[name] = value
        now[name] = FittedNumber(value=found, unit=parameter.unit, ci95=interval)
        if parameter.role == "size":
            moved |= not interval[0] <= value <= interval[1]
    places = dict.fromkeys(t.place for t in listed if t.effect == effect)
    return Earlier(
        effect=effect,
        places=tuple(place for place in places if place != WHOLE_ARM),
        outcome="not needed" if not needed else "changed" if moved else "stands",
        was=was,
        now=now if needed else {},
    )
