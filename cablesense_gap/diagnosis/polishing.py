"""A last fit of a hypothesis, with the tolerances as they act on the amended mechanism."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cablesense_gap.diagnosis.course import Course
from cablesense_gap.diagnosis.hypothesis import Hypothesis
from cablesense_gap.diagnosis.refining import refine
from cablesense_gap.diagnosis.scaled import to_scaled

_STEPS = 3


def polish(course: Course, hypothesis: Hypothesis) -> Hypothesis:
    """The same effects, fitted beside tolerances that are linear about these very effects.

    The search takes them linear about the nominal mechanism, which is near enough to choose by.
    """
    if not hypothesis.values:
        return hypothesis
    parameters = {
        term: parameter
        for term in hypothesis.values
        for candidate in course.simulator.candidates
        if candidate.effect == term.effect
        for parameter in candidate.parameters
        if parameter.name == term.parameter
    }
    start = [to_scaled(parameters[term], value) for term, value in hypothesis.values.items()]
    fitted = refine(_about(course, hypothesis), parameters, [start], _STEPS)
    if fitted is None or course.cost_of(fitted) > course.cost_of(hypothesis):
        return hypothesis
    return fitted


def _about(course: Course, hypothesis: Hypothesis) -> Course:
    """The course with sensitivities to tolerances at the hypothesis."""
    absent = dict.fromkeys(course.tolerance_terms, 0.0)
    variants = [{**hypothesis.values, **absent}]
    for term, std in zip(course.tolerance_terms, course.tolerance_std, strict=True):
        variants.append({**variants[0], term: float(std)})
    predicted = course.simulator.predict(variants)
    columns = predicted[1:] - predicted[0]
    if not np.isfinite(columns).all():
        return course
    return replace(course, tolerance_columns=columns)
