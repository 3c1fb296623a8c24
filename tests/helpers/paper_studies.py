"""Studies of the paper that cost nothing, and how a test runs a real one."""

from __future__ import annotations

import base64

from cablesense_gap.report.style import style
from paper.study import (
    CLOSED_FORM,
    PAPER,
    Agreement,
    PaperComparison,
    Picture,
    SmallTable,
    Study,
    StudyResult,
    chosen_studies,
    study_result,
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
        PaperComparison("slope", 1e7, 1e7, "N/m", Agreement.YES, "It is the stiffness."),
        PaperComparison("peak", 91.0, "about 100", "N", Agreement.PARTLY, "The servo gives."),
        PaperComparison("ratio", 0.5, 0.5, "", Agreement.YES, "Euler's.", CLOSED_FORM),
    ),
    notes=("The paper is silent on the amplitude.",),
)


def study(run=None, name="cable", quick="half the cables"):
    """A study that gives `RESULT` unless it is given something else to do."""
    return Study(name, "A cable", "Fig. 3", 1, quick, run or (lambda quick, progress: RESULT))


def failing(error):
    """A study that raises."""

    def run(quick, progress):
        raise error

    return study(run, name="rope")


def ignore(done):
    assert 0.0 <= done <= 1.0


def quick_result(name):
    """The result of a study in quick mode; whatever goes wrong is raised."""
    (chosen,) = chosen_studies([name])
    shares = []
    with style():
        result = chosen.run(True, shares.append)
    assert shares == sorted(shares)
    assert all(0.0 <= share <= 1.0 for share in shares)
    assert all(picture.png.startswith(b"\x89PNG") for picture in result.pictures)
    return result


def result_of(name, function, *arguments):
    """The result of a study of that name, its numbers and figures from a call of its function."""
    with style():
        return study_result(name, *function(*arguments, ignore))


def compared(result):
    """By quantity and source: ours, theirs and whether they agree."""
    return {(c.what, c.source): (c.ours, c.theirs, c.agreement) for c in result.comparisons}


def disagreeing(result):
    """Quantities that do not agree with a closed form or another part of this project."""
    return [c.what for c in result.comparisons if c.source != PAPER and c.agreement == "no"]
