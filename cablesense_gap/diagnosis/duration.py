"""How long a search will take, told before it begins, and the stages that it has.

The work is counted in units that are measured on the machine as it is now: preparing the problem
takes as long as so many fits of effects without a memory, and one course of a history-dependent
arm is what its fits consist of. Both carry the recording's rows, the arm's size and the load of
the machine. What shortens a diagnosis is in docs/troubleshooting.md, "A diagnosis takes long".
"""

from __future__ import annotations

import time

import numpy as np

from cablesense_gap.diagnosis.problem import Problem, noise_corrected_rms

WITHOUT_MEMORY_ENDS = 0.75
"""Share of a search at which the stage of effects without a memory ends,"""
WITH_MEMORY_ENDS = 0.95
"""that of history-dependent ones, and"""
COMPARING_ENDS = 0.97
"""the comparison of the best."""
STAGES = (
    ("effects without a memory", WITHOUT_MEMORY_ENDS),
    ("friction, creep and play", WITH_MEMORY_ENDS),
    ("comparing and describing", 1.0),
)
"""Stages of a diagnosis, each with the share of the whole at which it ends."""

HISTORY_SHARE = 0.05
"""Least share of a residual by friction or creep that shows where commands and load return."""

_PREPARATIONS = 7.0
"""Times the preparation, that effects without a memory take on one process."""
_COURSES = 450.0
"""Courses of an arm with history-dependent effects that their fits take on one process."""


def expected_s(problem: Problem, prepared_s: float, workers: int) -> float:
    """Seconds that the search of a problem takes, which was prepared in `prepared_s`."""
    total_s = _PREPARATIONS * prepared_s
    if may_depend_on_history(problem, problem.nominal):
        total_s += _COURSES * _course_s(problem)
    return total_s / max(workers, 1)


def may_depend_on_history(problem: Problem, predicted: np.ndarray) -> bool:
    """Whether the past may cause a part of a residual that is worth a search.

    Residual and past are compared in the rows that show both.
    """
    if not any(candidate.history_dependent for candidate in problem.simulator.candidates):
        return False
    past = problem.past
    if past is None:
        return True
    residual = (problem.readings - predicted)[past.rows]
    return past.rms > HISTORY_SHARE * noise_corrected_rms(
        float((residual**2).mean()), problem.floor
    )


def _course_s(problem: Problem) -> float:
    """Seconds of one simulation with a history-dependent effect, the second one: compiled."""
    simulator = (problem.subsample.problem if problem.subsample else problem).simulator
    candidate = next(each for each in simulator.candidates if each.history_dependent)
    terms = dict(zip(candidate.terms(candidate.places[0]), candidate.parameters, strict=True))
    took_s = 0.0
    for share in (1.0, 1.1):
        values = {
            term: float(np.clip(share * parameter.typical, parameter.low, parameter.high))
            for term, parameter in terms.items()
        }
        began_s = time.perf_counter()
        simulator.predict([values])
        took_s = time.perf_counter() - began_s
    return took_s
