"""Runs a study; one that fails stops no other."""

from __future__ import annotations

import time
import traceback
from dataclasses import dataclass

from cablesense_gap.report.figure_style import style
from cablesense_msgs_py.errors import CableSenseError
from cablesense_paper.study import Study, Tell
from cablesense_paper.study_result import StudyResult


@dataclass(frozen=True)
class Outcome:
    """What came of a study.

    Attributes:
        study: which.
        result: what it found; None where it failed.
        failure: why it failed; empty where it did not.
        seconds: that it took.
    """

    study: Study
    result: StudyResult | None
    failure: str
    seconds: float


def run_study(study: Study, quick: bool, tell: Tell) -> Outcome:
    """Run one study; whatever it raises is part of the outcome, Ctrl-C aside."""
    began = time.perf_counter()
    result, failure = None, ""
    try:
        with style():
            result = study.run(quick, tell)
    except CableSenseError as error:
        failure = str(error)
    except ModuleNotFoundError as error:
        failure = (
            f"it needs the Python package {error.name}, which is not installed; in a checkout run "
            "`make setup`, elsewhere pip install 'cablesense_ros[train,gap]'"
        )
    except Exception:
        failure = traceback.format_exc(limit=-3)
    return Outcome(study, result, failure, time.perf_counter() - began)
