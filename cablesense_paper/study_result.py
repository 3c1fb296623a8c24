"""What a study finds: pictures, small tables, and figures beside those that they should equal."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from cablesense_gap.report.figure_style import image_bytes

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
