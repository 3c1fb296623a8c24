"""Sets of cases as files: recordings as CSV, what is hidden in them as a table beside."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import astuple, fields
from math import ceil
from pathlib import Path

import numpy as np

from cablesense_base.arrays import Array
from cablesense_base.files import written_whole
from cablesense_base.workers import WorkerPool
from cablesense_gap.plant.body import Nominal, PlantError
from cablesense_gap.plant.case import NONE, Answer, CaseRecording, draw_case, record_case
from cablesense_gap.plant.listed import LISTED
from cablesense_gap.plant.unlisted import UNLISTED

_NONE_SHARE, _UNKNOWN_SHARE, _DOUBLE_SHARE = 0.2, 0.2, 0.12
_REDRAWS = 5


def withhold(
    folder: Path,
    answers_file: Path,
    nominal: Nominal,
    count: int,
    seed: int,
    only: Sequence[str] = (),
    workers: int = 1,
) -> Iterator[Answer]:
    """Write `case_001.csv` … into a folder and, at the end, the answers; yields them as they come.

    The same seed makes the same files, whatever the number of processes.

    Raises:
        PlantError: an unknown kind in `only`, or a place that cannot be written to.
    """
    kinds = draw_kinds(np.random.default_rng([seed]), count, only)
    answers = []
    with WorkerPool(workers, nominal, seed, refusal=PlantError) as pool:
        for recorded in pool.map(make_case, range(1, count + 1), kinds):
            _write_recording(folder / f"{recorded.answer.recording}.csv", recorded)
            answers.append(recorded.answer)
            yield recorded.answer
    names = [field.name for field in fields(Answer)]
    rows = ([_text(value) for value in astuple(answer)] for answer in answers)
    _write_table(answers_file, names, rows)


def draw_kinds(rng: np.random.Generator, count: int, only: Sequence[str] = ()) -> list[str]:
    """Kinds of `count` cases for `draw_case`, in random order.

    At least a fifth hide nothing and a fifth something that no verdict has a name for; an eighth
    hides two effects, the rest one. Effects come in turn, so that none comes twice before all
    have come once. With `only`, those kinds in turn.
    """
    if only:
        return [only[i % len(only)] for i in range(count)]
    listed, unlisted = _in_turn(rng, list(LISTED)), _in_turn(rng, list(UNLISTED))
    none, unknown = ceil(_NONE_SHARE * count), ceil(_UNKNOWN_SHARE * count)
    doubles = round(_DOUBLE_SHARE * count)
    singles = max(0, count - none - unknown - doubles)
    kinds = [NONE] * none
    kinds += [next(unlisted) for _ in range(unknown)]
    kinds += [next(listed) for _ in range(singles)]
    kinds += [_pair(listed) for _ in range(doubles)]
    return [kinds[i] for i in rng.permutation(len(kinds))][:count]


def make_case(nominal: Nominal, seed: int, index: int, kind: str) -> CaseRecording:
    """Case `index` (from 1) of the set of a seed; an arm that finds no rest is drawn anew."""
    for attempt in range(_REDRAWS):
        rng = np.random.default_rng([seed, index, attempt])
        try:
            return record_case(draw_case(rng, index, nominal, kind))
        except PlantError:
            if attempt == _REDRAWS - 1:
                raise
    raise AssertionError


def _in_turn(rng: np.random.Generator, names: list[str]) -> Iterator[str]:
    while True:
        yield from (names[i] for i in rng.permutation(len(names)))


def _pair(names: Iterator[str]) -> str:
    first = next(names)
    second = next(name for name in names if name != first)
    return "+".join(sorted((first, second)))


def _write_recording(path: Path, recorded: CaseRecording) -> None:
    """One row a sample, columns named with their units."""
    schedule = recorded.schedule
    angles, cables = schedule.command_rad.shape[1], recorded.tensions_n.shape[1]
    header = ["time_s", "trial", *(f"q{i + 1}_cmd_rad" for i in range(angles)), "load_segment"]
    header += ["load_x_n", "load_y_n", "load_z_n", *(f"tension_{i + 1}_n" for i in range(cables))]
    columns = [
        _texts(schedule.time_s[:, None], 2),
        [[str(trial)] for trial in schedule.trial],
        _texts(schedule.command_rad, 6),
        [[str(segment)] for segment in schedule.load_segment],
        _texts(schedule.load_n, 3),
        _texts(recorded.tensions_n, 4),
    ]
    rows = ([text for part in parts for text in part] for parts in zip(*columns, strict=True))
    _write_table(path, header, rows)


def _write_table(path: Path, header: list[str], rows: Iterable[list[str]]) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PlantError(f"{path}: cannot be written ({error.strerror or error})") from error
    with (
        written_whole(path, PlantError) as beside,
        beside.open("w", encoding="utf-8", newline="") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def _texts(values: Array, decimals: int) -> list[list[str]]:
    rounded = np.round(values, decimals) + 0.0  # no -0.00
    return [[f"{value:.{decimals}f}" for value in row] for row in rounded.tolist()]


def _text(value: object) -> str:
    return f"{value:.4f}" if isinstance(value, float) else str(value)
