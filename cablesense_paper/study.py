"""The studies of the paper: which there are, and how one is run."""

from __future__ import annotations

import importlib
import pkgutil
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from cablesense_base.errors import CableSenseError
from cablesense_gap.report.style import style
from cablesense_paper import studies
from cablesense_paper.study_result import StudyResult, filled, read_study_text

DRAWING = ("jinja2", "matplotlib")
"""What every report needs beyond the simulation; studies of networks need PyTorch too."""


class PaperError(CableSenseError):
    """What cannot be reproduced: no such study, or no place for the report."""


class FailedStudyError(PaperError):
    """Studies have failed; the others ran, and the report is there."""

    exit_code = 1


Progress = Callable[[float], None]
"""Receives, now and then, the share of a study that is done, from 0 to 1."""


@dataclass(frozen=True)
class Study:
    """One study of the paper, repeated.

    Attributes:
        name: of its files, and on the command line.
        title: its subject, in a few words.
        place: where the paper has it, as in `Fig. 5, II-D`.
        order: its place in the report; smaller comes first.
        quick: what the quick mode reduces, as half a sentence; empty where nothing.
        run: does it, from whether to be quick and `Progress`. Figures are drawn inside, in the
            report's style. What it raises is stated in the report, and the others still run.
    """

    name: str
    title: str
    place: str
    order: int
    quick: str
    run: Callable[[bool, Progress], StudyResult]


def study_names() -> tuple[str, ...]:
    """Names in the order of the alphabet; loads no study."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(studies.__path__)))


def all_studies() -> tuple[Study, ...]:
    """Every study, in the order of the paper; loads their text, not their code."""
    return tuple(sorted(map(_described, study_names()), key=lambda study: study.order))


def chosen_studies(only: Sequence[str]) -> tuple[Study, ...]:
    """Those named, or all where none is, in the order of the paper.

    Raises:
        PaperError: there is no study of that name.
    """
    known = study_names()
    for name in only:
        if name not in known:
            raise PaperError(f"no study {name!r}; there are {', '.join(known)}")
    return tuple(study for study in all_studies() if not only or study.name in only)


def _described(name: str) -> Study:
    text = read_study_text(name)
    quick = filled(text.get("quick", ""), text.get("sizes", {}))
    return Study(
        name, text["title"], text["place"], text["order"], quick, partial(_load_and_run, name)
    )


def _load_and_run(name: str, quick: bool, progress: Progress) -> StudyResult:
    """Studies load MuJoCo, matplotlib or PyTorch, so each is loaded only where it is run."""
    result: StudyResult = importlib.import_module(f"{studies.__name__}.{name}").run(
        quick, progress
    )
    return result


@dataclass(frozen=True)
class Outcome:
    """A study that has been run.

    Attributes:
        study: which.
        result: None where it failed.
        failure: why it failed; empty where it did not.
        seconds: that it took.
    """

    study: Study
    result: StudyResult | None
    failure: str
    seconds: float


def run_study(study: Study, quick: bool, progress: Progress) -> Outcome:
    """Run one study; whatever it raises is part of the outcome, Ctrl-C aside."""
    began = time.perf_counter()
    result, failure = None, ""
    try:
        with style():
            result = study.run(quick, progress)
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


def require_drawing() -> None:
    """Find the packages of page and pictures before anything runs, not after minutes.

    Raises:
        ModuleNotFoundError: one is not installed.
    """
    for name in DRAWING:
        importlib.import_module(name)
