"""What a study is.

What a study finds: pictures, small tables, and figures beside those that they should equal.

The errors of a reproduction of the paper.

Every study: the files of the folder `studies`.

Runs a study; one that fails stops no other.

What every report needs beyond the simulation; networks need more, and their studies say so.

Colours and line styles of the studies' figures: Okabe and Ito's, with a second cue beside.
"""

from __future__ import annotations

import importlib
import pkgutil
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from cablesense_base.errors import CableSenseError
from cablesense_gap.report.style import image_bytes, style
from cablesense_paper import studies

PAPER, CLOSED_FORM = "the paper", "closed form"
"""What figures are compared with."""

PRINT_DPI = 200


class Agreement(StrEnum):
    """Whether two figures say the same."""

    YES = "yes"
    PARTLY = "partly"
    NO = "no"

    @classmethod
    def within(cls, ours: float, theirs: float, tolerance: float) -> Agreement:
        """Yes where two numbers lie no further apart than `tolerance`, no where they do."""
        return cls.YES if abs(ours - theirs) <= tolerance else cls.NO


@dataclass(frozen=True)
class Picture:
    """An image.

    Attributes:
        name: of its file, without the ending.
        png: the file.
        caption: with the paper's figure number where it repeats one.
        alt: what it shows, for who cannot see it.
    """

    name: str
    png: bytes
    caption: str
    alt: str


@dataclass(frozen=True)
class SmallTable:
    """A table of few rows; numbers are shown with four digits."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str | float, ...], ...]


@dataclass(frozen=True)
class Comparison:
    """One figure of ours beside another.

    Attributes:
        what: the quantity.
        ours: what the study found, a number or words.
        theirs: what it should equal.
        unit: of both; empty for words.
        agreement: whether they say the same.
        why: one sentence on the agreement or the difference.
        source: whose the other is: the paper's, or that of a closed form.
    """

    what: str
    ours: float | str
    theirs: float | str
    unit: str
    agreement: Agreement
    why: str
    source: str = PAPER


@dataclass(frozen=True)
class StudyResult:
    """All that a study found.

    Attributes:
        lead: the finding, in one to three sentences.
        pictures, tables, comparisons: in the order of the page.
        notes: paragraphs on what was assumed where the paper is silent.
    """

    lead: str
    pictures: tuple[Picture, ...] = ()
    tables: tuple[SmallTable, ...] = ()
    comparisons: tuple[Comparison, ...] = ()
    notes: tuple[str, ...] = ()


def picture(name: str, figure: Any, caption: str, alt: str) -> Picture:
    """A drawn matplotlib figure as a picture, in a resolution for print; the figure is closed."""
    return Picture(name, image_bytes(figure, "png", PRINT_DPI), caption, alt)


Tell = Callable[[float], None]
"""Hears, now and then, which share of a study is done, from 0 to 1."""


@dataclass(frozen=True)
class Study:
    """One study of the paper, repeated.

    Attributes:
        name: as its file and the command call it.
        title: what it is about, in a few words.
        place: where the paper has it, as in `Fig. 5, II-D`.
        order: its place in the report; smaller comes first.
        quick: what the quick mode takes less of, as half a sentence; empty where nothing.
        run: does it, from whether to be quick and `Tell`. Figures are drawn inside, in the
            report's style. Whatever it raises is told in the report, and the others still run.
    """

    name: str
    title: str
    place: str
    order: int
    quick: str
    run: Callable[[bool, Tell], StudyResult]


class PaperError(CableSenseError):
    """What cannot be reproduced: no such study, or no place for the report."""


class FailedStudyError(PaperError):
    """Studies have failed; the others ran, and the report is there."""

    exit_code = 1


def study_names() -> tuple[str, ...]:
    """Names in the order of the alphabet; loads no study."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(studies.__path__)))


def all_studies() -> tuple[Study, ...]:
    """Every study, in the order of the paper."""
    found = [importlib.import_module(f"{studies.__name__}.{name}").STUDY for name in study_names()]
    return tuple(sorted(found, key=lambda study: (study.order, study.name)))


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


DRAWING = ("jinja2", "matplotlib")


def require_drawing() -> None:
    """Find the packages of page and pictures before anything runs, not after minutes.

    Raises:
        ModuleNotFoundError: one is not installed.
    """
    for name in DRAWING:
        importlib.import_module(name)


BLUE, ORANGE, GREEN, VERMILION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PURPLE, SKY, BLACK, GREY = "#CC79A7", "#56B4E9", "#1C2126", "#9AA3AD"
SERIES = (BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY)
DASHES = ("-", "--", "-.", ":")
"""Lines that differ in colour differ in their dashes too, for grey print."""
