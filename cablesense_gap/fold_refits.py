"""The amended arm as it would have come out without some of the trials."""

from __future__ import annotations

from dataclasses import replace

from cablesense_gap.amending import amended_arm
from cablesense_gap.diagnosis.course import Course
from cablesense_gap.diagnosis.refining import refine
from cablesense_gap.diagnosis.scaled import to_scaled
from cablesense_gap.simulator import Term
from cablesense_sim.arm import Arm
from cablesense_sim.effects.registry import known_effects

_STEPS = 3


def found_values(nominal: Arm, amended: Arm) -> dict[Term, float]:
    """The numbers of those effects that the amended arm lists beyond the nominal one.

    A workshop's tolerances are left out.
    """
    known = known_effects()
    return {
        Term(listed.effect, listed.at, name): value
        for listed in amended.effects[len(nominal.effects) :]
        if not known[listed.effect].tolerance
        for name, value in listed.parameters.items()
    }


def without_fold(course: Course, fold: int, nominal: Arm, amended: Arm) -> Arm:
    """The amended arm, its numbers and tolerances fitted again without the trials of a fold.

    The choice of effects and places stays, which was made with these trials; so does the arm as
    it is where the fit finds no rest.
    """
    values = found_values(nominal, amended)
    parameters = {
        term: parameter
        for term in values
        for candidate in course.simulator.candidates
        if candidate.effect == term.effect
        for parameter in candidate.parameters
        if parameter.name == term.parameter
    }
    seen = replace(course, used=course.used & (course.fold[course.trial] != fold))
    start = [to_scaled(parameters[term], value) for term, value in values.items()]
    fitted = refine(seen, parameters, [start], _STEPS)
    if fitted is None:
        return amended
    return amended_arm(nominal, fitted.values, fitted.tolerances)
