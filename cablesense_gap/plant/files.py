"""Cases as files: recordings as CSV, what is hidden in them as a table beside."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path

import numpy as np

from cablesense_gap.plant.case import Answer, CaseRecording
from cablesense_gap.plant.plant_error import PlantError


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
    beside = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with beside.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(header)
            writer.writerows(rows)
        beside.replace(path)
    except OSError as error:
        raise PlantError(f"{path}: cannot be written ({error.strerror or error})") from error


def _texts(values: np.ndarray, decimals: int) -> list[list[str]]:
    rounded = np.round(values, decimals) + 0.0  # no -0.00
    return [[f"{value:.{decimals}f}" for value in row] for row in rounded.tolist()]


def _text(value: object) -> str:
    return f"{value:.4f}" if isinstance(value, float) else str(value)
