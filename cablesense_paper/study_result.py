"""The result of a study, and how it is made of the study's numbers, figures and text.

The text is data, `studies/<name>.yaml` beside `studies/<name>.py`. A study computes numbers and
draws figures; titles, captions, references and sentences are templates of `str.format` that the
numbers are put into. The keys of a file:

    title, place, order, quick   of the study
    sizes     {full, quick}: how much is computed in either mode; `quick` may name them
    lead      the result in one to three sentences
    pictures  {name: {caption, alt}}
    tables    [{caption, head, rows: the rows' name among the numbers}]
    comparisons  [{what, ours, theirs, unit, why, source}] and one rule of agreement:
              within: a tolerance, at_most: or above: a limit of ours, agrees: the value itself
    notes     paragraphs

A template that is one field and nothing else, as in `ours: "{error_n}"`, stands for the value.
A table or comparison with the key `each` is repeated for every mapping of numbers in that list.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from importlib import resources
from typing import Any

from cablesense_base.errors import CableSenseError
from cablesense_base.plain_yaml import parse_plain_mapping
from cablesense_gap.report.style import image_bytes

PAPER, CLOSED_FORM = "the paper", "closed form"
"""Sources of references; a comparison that names none has the paper."""

PRINT_DPI = 200


class Agreement(StrEnum):
    """Whether a result agrees with its reference."""

    YES = "yes"
    PARTLY = "partly"
    NO = "no"

    @classmethod
    def within(cls, ours: float, theirs: float, tolerance: float) -> Agreement:
        """Yes where two numbers lie no further apart than `tolerance`, no where they do."""
        return cls.YES if abs(ours - theirs) <= tolerance else cls.NO

    @classmethod
    def of_parts(cls, parts: Sequence[bool]) -> Agreement:
        """Yes where all parts agree, partly where some do, no where none does."""
        return cls.YES if all(parts) else cls.PARTLY if any(parts) else cls.NO


@dataclass(frozen=True)
class Picture:
    """An image.

    Attributes:
        name: of its file, without the ending.
        png: the file.
        caption: with the paper's figure number where it repeats one.
        alt: the text for readers who cannot see it.
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
    """One result of ours beside its reference.

    Attributes:
        what: the quantity.
        ours: the result of the study, a number or text.
        theirs: what it should equal.
        unit: of both; empty for text.
        agreement: whether they agree.
        why: one sentence on the agreement or the difference.
        source: of the reference: the paper, a closed form, or another part of this project.
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
    """The result of a study.

    Attributes:
        lead: the result in one to three sentences.
        pictures, tables, comparisons: in the order of the page.
        notes: paragraphs on what was assumed where the paper is silent.
    """

    lead: str
    pictures: tuple[Picture, ...] = ()
    tables: tuple[SmallTable, ...] = ()
    comparisons: tuple[Comparison, ...] = ()
    notes: tuple[str, ...] = ()


Numbers = Mapping[str, Any]
"""By the names of the templates."""

_ONE_FIELD = re.compile(r"\{(\w+)\}")


@cache
def read_study_text(name: str) -> dict[str, Any]:
    """The file of a study, its templates still empty."""
    source = resources.files("cablesense_paper.studies").joinpath(f"{name}.yaml")
    text = source.read_text(encoding="utf-8")
    return parse_plain_mapping(text, source.name, "title, place, lead …", CableSenseError)


def study_size(name: str, quick: bool) -> dict[str, Any]:
    """How much a study computes in this mode."""
    sizes: dict[str, dict[str, Any]] = read_study_text(name)["sizes"]
    return sizes["quick" if quick else "full"]


def filled(template: Any, numbers: Numbers) -> Any:
    """A template with its numbers; what is no text stays as it is."""
    if not isinstance(template, str):
        return template
    field = _ONE_FIELD.fullmatch(template)
    return numbers[field[1]] if field else template.format_map(numbers)


def study_result(name: str, numbers: Numbers, figures: Mapping[str, Any]) -> StudyResult:
    """The result of a study from its numbers and drawn figures, which are closed."""
    text = read_study_text(name)
    pictures = tuple(
        Picture(
            name=picture,
            png=image_bytes(figures[picture], "png", PRINT_DPI),
            caption=filled(about["caption"], numbers),
            alt=filled(about["alt"], numbers),
        )
        for picture, about in text["pictures"].items()
    )
    tables = tuple(
        SmallTable(
            filled(table["caption"], own),
            tuple(filled(column, own) for column in table["head"]),
            tuple(tuple(row) for row in own[table["rows"]]),
        )
        for table, own in _each(text.get("tables", ()), numbers)
    )
    comparisons = tuple(
        Comparison(
            what=filled(entry["what"], own),
            ours=filled(entry["ours"], own),
            theirs=filled(entry["theirs"], own),
            unit=filled(entry.get("unit", ""), own),
            agreement=_agreement(entry, own),
            why=filled(entry["why"], own),
            source=entry.get("source", PAPER),
        )
        for entry, own in _each(text["comparisons"], numbers)
    )
    notes = tuple(_flat(filled(note, numbers) for note in text.get("notes", ())))
    return StudyResult(filled(text["lead"], numbers), pictures, tables, comparisons, notes)


def _each(
    entries: Sequence[dict[str, Any]], numbers: Numbers
) -> Iterator[tuple[dict[str, Any], Numbers]]:
    for entry in entries:
        for own in numbers[entry["each"]] if "each" in entry else ({},):
            yield entry, {**numbers, **own}


def _agreement(entry: dict[str, Any], numbers: Numbers) -> Agreement:
    if "agrees" in entry:
        return Agreement(filled(entry["agrees"], numbers))
    ours = filled(entry["ours"], numbers)
    if "within" in entry:
        theirs, tolerance = filled(entry["theirs"], numbers), filled(entry["within"], numbers)
        return Agreement.within(ours, theirs, tolerance)
    if "above" in entry:
        return Agreement.YES if ours > entry["above"] else Agreement.NO
    return Agreement.YES if ours <= filled(entry["at_most"], numbers) else Agreement.NO


def _flat(notes: Iterable[str | Sequence[str]]) -> Iterator[str]:
    """Notes one by one; a field may stand for several."""
    for note in notes:
        yield from (note,) if isinstance(note, str) else note
