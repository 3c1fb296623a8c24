"""A last fit of a hypothesis, with the tolerances as they act on the amended mechanism."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cablesense_gap.diagnosis.course import Course
from cablesense_gap.diagnosis.hypothesis import Hypothesis
from cablesense_gap.diagnosis.refitting import refit

_STEPS = 3


def polish(course: Course, hypothesis: Hypothesis) -> Hypothesis:
    """The same effects, fitted beside tolerances that are linear about these very effects.

    The search takes them linear about the nominal mechanism, which is near enough to choose by.
    """
    if not hypothesis.values:
        return hypothesis
    fitted = refit(_about(course, hypothesis), hypothesis.values, _STEPS)
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
