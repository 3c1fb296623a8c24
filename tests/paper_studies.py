"""Studies of the paper that cost nothing, and how a test runs a real one."""

from __future__ import annotations

import base64

from cablesense_paper.study import Study
from cablesense_paper.study_result import (
    CLOSED_FORM,
    Agreement,
    Comparison,
    Picture,
    SmallTable,
    StudyResult,
)

DOT = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR4nGNgYGD4DwABBAEAX+XDSwAAAABJRU5ErkJg"
    "gg=="
)
"""A PNG of one pixel."""

RESULT = StudyResult(
    lead="Cables <pull> & never push.",
    pictures=(Picture("dot", DOT, "Fig. 3 of the paper.", "a dot"),),
    tables=(SmallTable("Two cables.", ("cable", "tension, N"), (("cable_1", 50.0),)),),
    comparisons=(
        Comparison("slope", 1e7, 1e7, "N/m", Agreement.YES, "It is the stiffness."),
        Comparison("peak", 91.0, "about 100", "N", Agreement.PARTLY, "The servo gives."),
        Comparison("ratio", 0.5, 0.5, "", Agreement.YES, "Euler's.", CLOSED_FORM),
    ),
    notes=("The paper is silent on the amplitude.",),
)


def study(run=None, name="cable", quick="half the cables"):
    """A study that finds `RESULT` unless told to do something else."""
    return Study(name, "A cable", "Fig. 3", 1, quick, run or (lambda quick, tell: RESULT))


def ignore(done):
    assert 0.0 <= done <= 1.0
