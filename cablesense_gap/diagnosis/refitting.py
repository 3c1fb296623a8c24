"""A fit that goes on from numbers that are known already."""

from __future__ import annotations

from collections.abc import Mapping

from cablesense_gap.diagnosis.course import Course
from cablesense_gap.diagnosis.hypothesis import Hypothesis
from cablesense_gap.diagnosis.refining import refine
from cablesense_gap.diagnosis.scaled import to_scaled
from cablesense_gap.simulator import Candidate, Term
from cablesense_sim.effects.effect import Parameter


def refit(course: Course, values: Mapping[Term, float], most_steps: int) -> Hypothesis | None:
    """The most probable numbers from `values` on; None where these cannot be simulated.

    With no step allowed they stay, and only the tolerances are fitted.
    """
    candidates = {c.effect: c for c in course.simulator.candidates}
    parameters = {term: parameter_of(candidates, term) for term in values}
    start = [to_scaled(parameters[term], value) for term, value in values.items()]
    return refine(course, parameters, [start], most_steps)


def parameter_of(candidates: Mapping[str, Candidate], term: Term) -> Parameter:
    """What a number is, and within which range."""
    return next(p for p in candidates[term.effect].parameters if p.name == term.parameter)
