"""The studies of the paper: which there are, how one is run, and how its result is made.

A study is a function that gives numbers and figures, and a text with templates of `str.format`
that the numbers are put into, `studies/<name>.yaml`. The keys of a text:

    function  module and name of the function in `paper.studies`
    title, place, order, quick   of the study
    sizes     {full, quick}: what the function is given in either mode; `quick` may name them
    lead      the result in one to three sentences
    pictures  {name: {caption, alt}}
    tables    [{caption, head, rows}]
    comparisons  [{what, ours, theirs, unit, why, source}] and one rule of agreement:
              within: a tolerance, at_most: or above: a limit of ours, or agrees: the value itself,
              a condition or several. What is not met counts as `otherwise`, or as no
    notes     paragraphs

A template that is one field and nothing else, as in `ours: "{error_n}"`, stands for the value.
A table or comparison with the key `each` is repeated for every mapping of numbers in that list.
"""

from __future__ import annotations

import importlib
import re
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache, partial
from importlib import resources
from string import Formatter
from typing import Any

from cablesense_base import CableSenseError
from cablesense_base.installation import missing_package_line
from cablesense_base.plain_yaml import parse_plain_mapping
from cablesense_gap.report.style import image_bytes, style

PAPER = "the paper"
CLOSED_FORM = "closed form"
"""Sources of references; a comparison that names none has the paper."""

PRINT_DPI = 200
_STUDIES = "paper.studies"

Numbers = Mapping[str, Any]
"""By the names of the templates."""

Figures = Mapping[str, Any]
"""Drawn by matplotlib, by the names of the pictures."""

Progress = Callable[[float], None]
"""Receives, now and then, the share of a study that is done, from 0 to 1."""


class PaperError(CableSenseError):
    """What cannot be reproduced: no such study, or no place for the report."""


class FailedStudyError(PaperError):
    """Studies have failed; the others ran, and the report is there."""

    exit_code = 1


class Agreement(StrEnum):
    """Whether a result agrees with its reference."""

    YES = "yes"
    PARTLY = "partly"
    NO = "no"


@dataclass(frozen=True)
class Picture:
    """A PNG image: name of its file without the ending, caption, and text for who cannot see it.

    The caption has the paper's figure number where the picture repeats one.
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
class PaperComparison:
    """One result of ours and its reference, both numbers or text.

    `why` is one sentence on the agreement or the difference; `source` is that of the reference:
    the paper, a closed form, or another part of this project.
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
    """The result of a study: a lead of one to three sentences, and what follows on the page."""

    lead: str
    pictures: tuple[Picture, ...] = ()
    tables: tuple[SmallTable, ...] = ()
    comparisons: tuple[PaperComparison, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Study:
    """One study of the paper, repeated.

    Attributes:
        place: where the paper has it, as in `Fig. 5, II-D`.
        order: its place in the report; smaller comes first.
        quick: what the quick mode reduces, as half a sentence; empty where nothing.
        run: does it, from whether to be quick and `Progress`; to be called in the report's style.
    """

    name: str
    title: str
    place: str
    order: int
    quick: str
    run: Callable[[bool, Progress], StudyResult]


@dataclass(frozen=True)
class StudyOutcome:
    """A study that has been run: its result, or why there is none, and the seconds it took."""

    study: Study
    result: StudyResult | None
    failure: str
    seconds: float


def study_names() -> tuple[str, ...]:
    """Names in the order of the alphabet; loads no study."""
    files = (file.name.partition(".") for file in resources.files(_STUDIES).iterdir())
    return tuple(sorted(name for name, _, ending in files if ending == "yaml"))


def chosen_studies(only: Sequence[str] = ()) -> tuple[Study, ...]:
    """Those named, or all where none is, in the order of the paper; loads no code of theirs.

    Raises:
        PaperError: there is no study of that name.
    """
    known = study_names()
    for name in only:
        if name not in known:
            raise PaperError(f"no study {name!r}; there are {', '.join(known)}")
    chosen = []
    for name in dict.fromkeys(only or known):
        text = read_study_text(name)
        quick = filled(text.get("quick", ""), text.get("sizes", {}))
        run = partial(_load_and_run, name)
        chosen.append(Study(name, text["title"], text["place"], text["order"], quick, run))
    return tuple(sorted(chosen, key=lambda study: study.order))


def _load_and_run(name: str, quick: bool, progress: Progress) -> StudyResult:
    """Studies load MuJoCo, matplotlib or PyTorch, so each is loaded only where it is run."""
    text = read_study_text(name)
    module, _, function = text["function"].partition(".")
    run = getattr(importlib.import_module(f"{_STUDIES}.{module}"), function)
    size = text.get("sizes", {}).get("quick" if quick else "full", {})
    return study_result(name, *run(size, progress))


def run_study(study: Study, quick: bool, progress: Progress) -> StudyOutcome:
    """Run one study; whatever it raises is part of the outcome, Ctrl-C aside."""
    began = time.perf_counter()
    result = None
    failure = ""
    try:
        with style():
            result = study.run(quick, progress)
    except CableSenseError as error:
        failure = str(error)
    except ModuleNotFoundError as error:
        failure = missing_package_line(error)
    except Exception:
        failure = traceback.format_exc(limit=-3)
    return StudyOutcome(study, result, failure, time.perf_counter() - began)


@cache
def read_study_text(name: str) -> dict[str, Any]:
    """The text of a study, its templates still empty."""
    source = resources.files(_STUDIES).joinpath(f"{name}.yaml")
    text = source.read_text(encoding="utf-8")
    return parse_plain_mapping(text, source.name, "title, place, lead …", CableSenseError)


def study_result(name: str, numbers: Numbers, figures: Figures) -> StudyResult:
    """The result of a study from its numbers and drawn figures, which are closed."""
    text = read_study_text(name)
    pictures = tuple(
        Picture(
            picture,
            image_bytes(figures[picture], "png", PRINT_DPI),
            filled(about["caption"], numbers),
            filled(about["alt"], numbers),
        )
        for picture, about in text["pictures"].items()
    )
    tables = tuple(
        SmallTable(
            filled(table["caption"], cell_numbers),
            tuple(filled(column, cell_numbers) for column in table["head"]),
            tuple(
                tuple(filled(cell, cell_numbers) for cell in row)
                for row in filled(table["rows"], cell_numbers)
            ),
        )
        for table, cell_numbers in _each(text.get("tables", ()), numbers)
    )
    comparisons = tuple(
        PaperComparison(
            **{key: filled(entry[key], cell_numbers) for key in ("what", "ours", "theirs", "why")},
            unit=filled(entry.get("unit", ""), cell_numbers),
            agreement=_agreement(entry, cell_numbers),
            source=entry.get("source", PAPER),
        )
        for entry, cell_numbers in _each(text["comparisons"], numbers)
    )
    notes: list[str] = []
    for template in text.get("notes", ()):
        note = filled(template, numbers)
        notes += (note,) if isinstance(note, str) else note  # a field may stand for several
    lead = filled(text["lead"], numbers)
    return StudyResult(lead, pictures, tables, comparisons, tuple(notes))


def filled(template: Any, numbers: Numbers) -> Any:
    """A template with its numbers; what is no text stays as it is."""
    if not isinstance(template, str):
        return template
    field = re.fullmatch(r"\{([\w\[\]]+)\}", template)
    return (
        Formatter().get_field(field[1], (), numbers)[0] if field else template.format_map(numbers)
    )


def _each(
    entries: Sequence[dict[str, Any]], numbers: Numbers
) -> Iterator[tuple[dict[str, Any], Numbers]]:
    for entry in entries:
        for values in numbers[entry["each"]] if "each" in entry else ({},):
            yield entry, {**numbers, **values}


def _agreement(entry: Mapping[str, Any], numbers: Numbers) -> Agreement:
    ours = filled(entry["ours"], numbers)
    theirs = filled(entry["theirs"], numbers)
    if "agrees" in entry:
        met = filled(entry["agrees"], numbers)
        if isinstance(met, str):
            return Agreement(met)
    elif "within" in entry:
        met = abs(ours - theirs) <= filled(entry["within"], numbers)
    elif "above" in entry:
        met = ours > entry["above"]
    else:
        met = ours <= filled(entry["at_most"], numbers)
    parts = met if isinstance(met, list) else [met]
    if all(parts):
        return Agreement.YES
    return Agreement.PARTLY if any(parts) else Agreement(entry.get("otherwise", "no"))
