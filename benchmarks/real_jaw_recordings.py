"""Recordings of a cable-driven jaw, with angle and torque measured at both ends of the cables.

A folder has `index.csv`, one line a recording (recording, folder, frequency_hz, brake_percent),
and a `<recording>.csv.gz` for each. `folder` names the tool and how it is mounted: recordings of
one such name are taken as recordings of one mechanism.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from cablesense_base import Array, CableSenseError

SAMPLE_S = 0.01
INDEX_COLUMNS = ("recording", "folder", "frequency_hz", "brake_percent")
COLUMNS = (
    "time_s",
    "drive_angle_rad",
    "drive_torque_nm",
    "motor_current_a",
    "jaw_angle_rad",
    "jaw_torque_nm",
)


class JawRecordingError(CableSenseError):
    """A folder of recordings that cannot be used."""


@dataclass(frozen=True, eq=False)
class JawRecording:
    """One course of the drive against one level of the jaw's brake, T samples at 100 Hz.

    Attributes:
        name: of its file.
        tool: the mechanism that it was recorded on.
        frequency_hz: of the drive's sine.
        brake_percent: nominal level of the brake.
        drive_angle_rad: (T,) at the spindle, as are the drive's torque and its motor's current.
        jaw_angle_rad: (T,) at the jaw; no estimator uses it.
        jaw_torque_nm: (T,) what the estimators are to give.
    """

    name: str
    tool: str
    frequency_hz: float
    brake_percent: float
    drive_angle_rad: Array
    drive_torque_nm: Array
    motor_current_a: Array
    jaw_angle_rad: Array
    jaw_torque_nm: Array


class Part(NamedTuple):
    """Recordings of one tool to adapt to, none for that which was trained on, and to test on."""

    tool: str
    adapt: tuple[JawRecording, ...]
    test: tuple[JawRecording, ...]


def read_recordings(folder: str | Path) -> list[JawRecording]:
    """Every recording that the folder's index lists.

    Raises:
        JawRecordingError: no such file, a column missing, a cell that is no number, not sampled
            at 100 Hz.
    """
    folder = Path(folder)
    index = _table(folder / "index.csv", INDEX_COLUMNS)
    if (index.frequency_hz <= 0.0).any():
        raise JawRecordingError(f"{folder / 'index.csv'}: frequency_hz is to be positive")
    if index.empty:
        raise JawRecordingError(
            f"{folder / 'index.csv'}: no recordings; one line each is expected"
        )
    return [
        _recording(
            folder / f"{row.recording}.csv.gz",
            str(row.folder),
            float(row.frequency_hz),
            float(row.brake_percent),
        )
        for row in index.itertuples()
    ]


def reference(recordings: Sequence[JawRecording]) -> list[JawRecording]:
    """Those of the tool with most levels of the brake."""
    tools = dict.fromkeys(r.tool for r in recordings)
    tool = max(tools, key=lambda tool: len(_levels(recordings, tool)))
    return [r for r in recordings if r.tool == tool]


def split(
    train: Sequence[JawRecording], test: Sequence[JawRecording] | None, adapt: int
) -> tuple[list[JawRecording], list[Part]]:
    """What to train on, and the parts to test on, tool by tool.

    Without recordings to test on, the reference tool is the one to train on, on its 1st, 3rd and
    5th … level of the brake, and to test on the levels between. A tool that was trained on needs
    no adapting, or has its own to adapt to where it is not the reference. Of any other, `adapt`
    recordings evenly spread over the index are those to adapt to, and the rest is tested.

    Raises:
        JawRecordingError: too few recordings of a tool to adapt to and to test on.
    """
    if adapt < 0:
        raise JawRecordingError(f"{adapt} recordings to adapt to; none or more are possible")
    parts, own = [], reference(train)
    if test is None:
        levels = _levels(own, own[0].tool)
        if len(levels) < 2:
            raise JawRecordingError(
                f"{own[0].tool} has one level of the brake; two are needed to test on another "
                "one, or recordings to test on"
            )
        test = [r for r in train if r not in own]
        train = [r for r in own if r.brake_percent in levels[::2]]
        parts.append(Part(own[0].tool, (), tuple(r for r in own if r not in train)))
    for tool in dict.fromkeys(r.tool for r in test):
        tested = [r for r in test if r.tool == tool]
        known = [r for r in train if r.tool == tool]
        if known or not adapt:
            known = [] if tool == own[0].tool else known
        elif len(tested) > adapt:
            spread = np.linspace(0, len(tested) - 1, adapt).round().astype(int)
            known = [tested[k] for k in spread]
            tested = [r for r in tested if r not in known]
        else:
            raise JawRecordingError(
                f"{tool} has {len(tested)} recordings; {adapt} to adapt to and one to test on are "
                "needed"
            )
        parts.append(Part(tool, tuple(known), tuple(tested)))
    return list(train), parts


def _levels(recordings: Sequence[JawRecording], tool: str) -> list[float]:
    return sorted({r.brake_percent for r in recordings if r.tool == tool})


def _recording(path: Path, tool: str, frequency_hz: float, brake_percent: float) -> JawRecording:
    table = _table(path, COLUMNS)
    values = {name: table[name].to_numpy(float) for name in COLUMNS}
    time_s = values.pop("time_s")
    if len(time_s) < 2 or np.abs(np.diff(time_s) - SAMPLE_S).max() > 0.1 * SAMPLE_S:
        raise JawRecordingError(f"{path}: time_s is not evenly spaced by {SAMPLE_S} s")
    name = path.name.removesuffix(".csv.gz")
    return JawRecording(name, tool, frequency_hz, brake_percent, **values)


def _table(path: Path, columns: Sequence[str]) -> pd.DataFrame:
    try:
        table = pd.read_csv(path)
    except FileNotFoundError:
        raise JawRecordingError(f"{path}: no such file") from None
    except (OSError, ValueError, EOFError) as error:
        raise JawRecordingError(f"{path}: no table of comma-separated values: {error}") from None
    if missing := [name for name in columns if name not in table]:
        raise JawRecordingError(
            f"{path}: no column {', '.join(missing)}; expected are {', '.join(columns)}"
        )
    for name in columns[2:] if columns is INDEX_COLUMNS else columns:
        cells = pd.to_numeric(table[name], errors="coerce").to_numpy(float)
        if (bad := np.flatnonzero(~np.isfinite(cells))).size:
            raise JawRecordingError(
                f"{path}: row {bad[0] + 1}, column {name}: {table[name].iloc[bad[0]]} is no "
                "finite number"
            )
    return table
