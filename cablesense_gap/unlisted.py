"""What can be said of a gap that no listed effect explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.closer_look import closer_look
from cablesense_gap.course_features import course_features
from cablesense_gap.diagnosis.course import Course
from cablesense_gap.diagnosis.discrepancy import discrepancy
from cablesense_gap.diagnosis.hypothesis import Hypothesis
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.residuals.looks import looks_like
from cablesense_sim.arm import Arm

Array = NDArray[np.float64]

ONE_AT_A_TIME = (
    "Record again what the regimes above name, and change one thing at a time: "
    "`cablesense gap protocol` lists loads, poses and holds that part most effects."
)


@dataclass(frozen=True)
class Unlisted:
    """A gap without a name.

    Attributes:
        reasons: why no listed effect is named, and what the gap looks like.
        next_experiment: what to record to learn more.
        held_out_n: (R, M) what a flexible model predicts, each trial without its fold.
    """

    reasons: tuple[str, ...]
    next_experiment: str
    held_out_n: Array


def describe_unlisted(
    course: Course, recording: Recording, fitted: Sequence[Hypothesis], arm: Arm
) -> Unlisted:
    """What tolerances leave, as a flexible model that knows no physics sees it.

    `fitted` are all hypotheses, among them that of tolerances alone.
    """
    none = next(h for h in fitted if not h.effects)
    residual = course.readings - none.held_out
    found = discrepancy(
        course_features(recording, course.nominal, arm),
        residual,
        course.trial,
        course.fold,
        course.used,
        course.floor,
    )
    best = min(fitted, key=lambda h: h.held_out_rmse)
    rows = recording.rows(course.used)
    looks = looks_like(rows, residual[course.used], found, arm, course.floor)
    try:
        again = closer_look(rows, residual[course.used], course.floor).text
    except ValueError:
        again = ONE_AT_A_TIME
    return Unlisted(
        reasons=(
            f"Tolerances alone leave {none.held_out_rmse:.2f} N on trials that were not fitted; "
            f"the best that listed effects do is {best.held_out_rmse:.2f} N "
            f"({' with '.join(best.effects).replace('_', ' ') or 'none'}).",
            f"A flexible model, which knows commands, loads, directions and time but no physics, "
            f"explains {max(found.explained_share, 0.0):.0%} of what is left on such trials.",
            *looks,
        ),
        next_experiment=again,
        held_out_n=none.held_out + found.held_out,
    )
