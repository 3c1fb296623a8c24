"""A set of recordings whose effects are withheld, one after the other or in several processes.

Cases as files: recordings as CSV, what is hidden in them as a table beside.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import fields
from pathlib import Path

import numpy as np

from cablesense_base.files import written_whole
from cablesense_base.workers import WorkerPool
from cablesense_gap.plant.body import Nominal, PlantError
from cablesense_gap.plant.case import Answer, CaseRecording, draw_case, draw_kinds, record_case


def write_recording(path: Path, recorded: CaseRecording) -> None:
    """Write a recording: one row a sample, its columns named with their units.

    Raises:
        PlantError: the place cannot be written to.
    """
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
    _write(path, header, rows)


def write_answers(path: Path, answers: Iterable[Answer]) -> None:
    """Write what is hidden, one row a recording.

    Raises:
        PlantError: the place cannot be written to.
    """
    names = [field.name for field in fields(Answer)]
    rows = ([_text(getattr(answer, name)) for name in names] for answer in answers)
    _write(path, names, rows)


def _write(path: Path, header: list[str], rows: Iterable[list[str]]) -> None:
    with suppress(OSError):  # what is wrong is found on writing
        path.parent.mkdir(parents=True, exist_ok=True)
    with (
        written_whole(path, PlantError) as beside,
        beside.open("w", encoding="utf-8", newline="") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def _texts(values: np.ndarray, decimals: int) -> list[list[str]]:
    rounded = np.round(values, decimals) + 0.0  # no -0.00
    return [[f"{value:.{decimals}f}" for value in row] for row in rounded.tolist()]


def _text(value: object) -> str:
    return f"{value:.4f}" if isinstance(value, float) else str(value)


_REDRAWS = 5


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
    numbers = range(1, count + 1)
    answers = []
    with WorkerPool(workers, nominal, seed, refusal=PlantError) as pool:
        for recorded in pool.map(make_case, numbers, kinds):
            write_recording(folder / f"{recorded.answer.recording}.csv", recorded)
            answers.append(recorded.answer)
            yield recorded.answer
    write_answers(answers_file, answers)
