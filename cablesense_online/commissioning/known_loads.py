"""Known loads on single cables, and the table in which a person notes them.

What sensors read under known loads, in their signals' units: as noted, or from a recording.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cablesense_gap.recordings.recording import Recording
from cablesense_online.can.channel_map import ChannelMap
from cablesense_online.commissioning.readings import (
    CommissioningError,
    TableRow,
    TimeWindow,
    read_table,
    window_of,
)
from cablesense_online.commissioning.sensor_calibration import CalibrationPoint

STANDARD_GRAVITY_M_S2 = 9.80665
"""3rd CGPM (1901)."""

GRAVITY_RELATIVE_U = 0.0015
"""Standard uncertainty of the standard value where nobody gave the local one: normal gravity goes
from 9.7803 m/s² at the equator to 9.8322 at the poles (WGS 84); half of that over root 3."""

HEAVIEST_N = 20_000.0
LARGEST_RAW = 1e11

COLUMNS = ("mass_kg", "mass_u_kg", "force_n", "force_u_n", "raw", "raw_u", "start_s", "end_s")


@dataclass(frozen=True)
class KnownLoad:
    """One load on one cable.

    Attributes:
        where: file and row, for errors.
        cable: name of the cable it hung on.
        by_mass: whether its force was taken from a mass, so that gravity's uncertainty counts.
        force_n: its pull on the cable.
        force_u_n: standard uncertainty of that, beyond what all loads have in common; 0 unknown.
        reading: what the sensor read, in the signal's unit, or when to look for it in a recording.
        raw_u: standard uncertainty of the reading; 0 unknown.
    """

    where: str
    cable: str
    by_mass: bool
    force_n: float
    force_u_n: float
    reading: float | TimeWindow
    raw_u: float


def read_known_loads(
    path: str | Path, cable_names: Sequence[str], gravity_m_s2: float = STANDARD_GRAVITY_M_S2
) -> dict[str, list[KnownLoad]]:
    """Known loads by cable, each in the order in which they were put on.

    Columns: `cable`; `mass_kg` or `force_n`; `raw`, or `start_s` and `end_s`; if known also
    `mass_u_kg` or `force_u_n`, and `raw_u`. A load of 0 is the bare cable.

    Raises:
        CableSenseError: the file cannot be read as such a table.
        CommissioningError: a row names no cable of `cable_names`, lacks load or reading, or has
            two of either.
    """
    loads: dict[str, list[KnownLoad]] = {}
    for row in read_table(path, ("cable",), COLUMNS):
        load = _load(row, cable_names, gravity_m_s2)
        loads.setdefault(load.cable, []).append(load)
    return loads


def _load(row: TableRow, cable_names: Sequence[str], gravity_m_s2: float) -> KnownLoad:
    cable = row.text("cable")
    if cable not in cable_names:
        raise CommissioningError(
            f"{row.where}: no cable {cable[:40]!r}; there are {', '.join(cable_names)}"
        )
    by_mass = _one_of(row.cells, row.where, "mass_kg", "force_n") == "mass_kg"
    value, spread, newtons = (
        ("mass_kg", "mass_u_kg", gravity_m_s2) if by_mass else ("force_n", "force_u_n", 1.0)
    )
    force_n = newtons * row.number(value, 0.0, HEAVIEST_N / newtons)
    force_u_n = newtons * _optional(row, spread)
    read = _one_of(row.cells, row.where, "raw", "start_s") == "raw"
    reading = row.number("raw", -LARGEST_RAW, LARGEST_RAW) if read else window_of(row)
    return KnownLoad(
        row.where, cable, by_mass, force_n, force_u_n, reading, _optional(row, "raw_u")
    )


def _one_of(cells: Mapping[str, str], where: str, first: str, second: str) -> str:
    given = [name for name in (first, second) if cells.get(name)]
    if len(given) != 1:
        raise CommissioningError(
            f"{where}: gives {'both' if given else 'neither'} {first} {'and' if given else 'nor'} "
            f"{second}; it must give one"
        )
    return given[0]


def _optional(row: TableRow, column: str) -> float:
    return row.number(column, 0.0, LARGEST_RAW) if row.cells.get(column) else 0.0


FEWEST_SAMPLES = 10
"""In a window; the mean of fewer is hardly better than one reading."""


def calibration_points(
    loads: Mapping[str, Sequence[KnownLoad]],
    as_recorded: ChannelMap,
    recording: Recording | None,
) -> dict[str, list[CalibrationPoint]]:
    """The points of every cable that has loads, in the order of the loads.

    Args:
        loads: by cable.
        as_recorded: the map, with the scales and zeros that were in force when the recording was
            made: with them its tensions are turned back into the signals' values. Its channels
            are in the order of the recording's tensions.
        recording: where the loads' windows lie, if any has one.

    Raises:
        CommissioningError: a window without a recording, or with too few samples in it.
    """
    return {
        cable: [_point(load, as_recorded, recording) for load in of_cable]
        for cable, of_cable in loads.items()
    }


def _point(
    load: KnownLoad, as_recorded: ChannelMap, recording: Recording | None
) -> CalibrationPoint:
    if isinstance(load.reading, float):
        return CalibrationPoint(load.force_n, load.reading, load.force_u_n, load.raw_u)
    if recording is None:
        raise CommissioningError(
            f"{load.where}: gives start_s and end_s; give the recording as well, or the reading "
            "under raw"
        )
    rows = load.reading.rows(recording.time_s)
    if np.count_nonzero(rows) < FEWEST_SAMPLES:
        raise CommissioningError(
            f"{load.where}: only {np.count_nonzero(rows)} samples of {recording.name} lie from "
            f"{load.reading.start_s:g} to {load.reading.end_s:g} s; there must be at least "
            f"{FEWEST_SAMPLES}, and the recording goes from {recording.time_s[0]:g} to "
            f"{recording.time_s[-1]:g} s"
        )
    column = as_recorded.cable_names.index(load.cable)
    tension_n = float(recording.tensions_n[rows, column].mean())
    raw = as_recorded.channels[load.cable].value(tension_n)
    return CalibrationPoint(load.force_n, raw, load.force_u_n, load.raw_u)
