"""What a study is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cablesense_paper.study_result import StudyResult

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
