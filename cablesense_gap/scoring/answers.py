"""The answers that were withheld: what each recording's arm really had."""

from __future__ import annotations

import csv
import math
import re
from dataclasses import dataclass
from pathlib import Path

from cablesense_gap.scoring.score_error import ScoreError
from cablesense_gap.verdict import NONE, UNKNOWN
from cablesense_msgs_py.bounded_file import read_bounded_text

COLUMNS = ("recording", "effects", "where")
GAP_OVER_FLOOR = "gap_over_floor"
FORM = "form"

MAX_FILE_BYTES = 10_000_000
"""Some hundred thousand recordings."""

_NAME = re.compile(r"[a-z][a-z0-9_]*")
_PLACE = re.compile(r"(?:cable|segment|joint)_[1-9]\d*")


@dataclass(frozen=True)
class Answer:
    """The truth about one recording.

    Attributes:
        recording: its name, without a suffix.
        effects: `("none",)`, `("unknown",)`, or names in alphabetical order.
        places: cables, segments and joints that the answer names; empty if it names none.
        gap_over_floor: RMS gap of the nominal arm in noise floors, if the file gives it.
        form: which form of the effect the plant has, if the file gives it.
    """

    recording: str
    effects: tuple[str, ...]
    places: frozenset[str] = frozenset()
    gap_over_floor: float | None = None
    form: str = ""


def read_answers(path: str | Path) -> tuple[Answer, ...]:
    """Read answers: CSV with `recording,effects,where`; effects are joined by `+`.

    In `where`, places are found whatever stands between them, so that
    `cable_2_into_cable_5` and `cable_2 cable_5` say the same.

    Raises:
        ScoreError: the file cannot be read, a column is missing, a row cannot be.
    """
    path = Path(path)
    try:
        text = read_bounded_text(path, MAX_FILE_BYTES, "a table of answers", ScoreError)
        table = csv.DictReader(text.splitlines(), skipinitialspace=True)
        rows = list(table)
    except (ValueError, csv.Error) as error:
        raise ScoreError(f"{path}: cannot be read as CSV text ({error})") from error
    missing = [name for name in COLUMNS if name not in (table.fieldnames or ())]
    if missing:
        raise ScoreError(f"{path}: misses column {missing[0]}; answers have {', '.join(COLUMNS)}")
    if not rows:
        raise ScoreError(f"{path}: has no rows; one for each recording is right")
    answers = tuple(_answer(f"{path}: row {i}", row) for i, row in enumerate(rows, start=1))
    names = [answer.recording for answer in answers]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ScoreError(f"{path}: recording {twice} stands twice; each must be once")
    return answers


def _answer(at: str, row: dict[str, str | None]) -> Answer:
    cells = {key: (value or "").strip() for key, value in row.items() if isinstance(key, str)}
    recording = Path(cells["recording"]).name.removesuffix(".csv")
    if not recording:
        raise ScoreError(f"{at}: names no recording")
    effects = tuple(sorted(name.strip() for name in cells["effects"].split("+")))
    if not all(_NAME.fullmatch(name) for name in effects) or len(set(effects)) < len(effects):
        raise ScoreError(
            f"{at}: effects = {cells['effects'][:80]!r}; must be names joined by +, each once"
        )
    for alone in (NONE, UNKNOWN):
        if alone in effects and len(effects) > 1:
            raise ScoreError(f"{at}: effects = {'+'.join(effects)}; {alone} must stand alone")
    return Answer(
        recording=recording,
        effects=effects,
        places=frozenset(_PLACE.findall(cells["where"])),
        gap_over_floor=_number(at, cells.get(GAP_OVER_FLOOR, "")),
        form=cells.get(FORM, ""),
    )


def _number(at: str, cell: str) -> float | None:
    if not cell:
        return None
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0.0):
        raise ScoreError(f"{at}: {GAP_OVER_FLOOR} = {cell[:40]!r}; must be a number from 0 up")
    return value
