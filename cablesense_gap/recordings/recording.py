"""One recording of an arm, as arrays, and the trials of one that names none."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, CableSenseError

_STILL_S = 1.0
"""A command that has not changed for this long stands still."""
_REST_S = 3.0
"""An arm without load for this long is at rest; steps of a load come faster."""
_GAP_S = 1.0
_GAP_INTERVALS = 5.0
_SAME_SIDE_COSINE = 0.866
"""Loads within 30 degrees of each other come from one side."""
SAME_PLACE_M = 0.002
"""Loads within 2 mm of each other act at one place."""

MAX_NUMBERS = 100_000_000
"""Size limit of a recording: an hour at 1 kHz of an arm with twelve cables, 0.8 GB in memory."""

_SHOWN = 5


class RecordingError(CableSenseError):
    """A recording that cannot be used: names the file, the rows, the fault and the remedy."""


@dataclass(frozen=True)
class Recording:
    """Commands, known loads and readings of an arm: R rows in time order.

    Attributes:
        name: of the file it came from, without its suffix.
        time_s: (R,) since the recording began.
        trial: (R,) blocks that belong together; they are held out whole.
        command_rad: (R, 2N) commanded joint angles, pitch then yaw of each joint, base first.
        load_segment: (R,) 1 to N where a known load acts, else 0.
        load_n: (R, 3) that load, base frame.
        tensions_n: (R, M) as the sensors at the actuator ends read them.
        load_at_m: (R,) where on its segment's axis the load acts, from the joint centre; NaN for
            the arm file's `contact_m`. None where no row states a place.
    """

    name: str
    time_s: Array
    trial: NDArray[np.int64]
    command_rad: Array
    load_segment: NDArray[np.int64]
    load_n: Array
    tensions_n: Array
    load_at_m: Array | None = None

    def __len__(self) -> int:
        """Number of rows R."""
        return len(self.time_s)

    @property
    def forces_n(self) -> Array:
        """(R, N, 3) the load as one base-frame force per segment."""
        return self._loaded[..., None] * self.load_n[:, None, :]

    @property
    def inputs(self) -> tuple[Array, Array, Array, Array | None]:
        """Times, commands, loads and their places, as `cablesense_sim.replay.Replay` takes them.

        Places are (R, N), NaN for the arm file's `contact_m`; None where no row states one.
        """
        at_m = self.load_at_m
        places_m = None if at_m is None else np.where(self._loaded, at_m[:, None], np.nan)
        return self.time_s, self.command_rad, self.forces_n, places_m

    @property
    def _loaded(self) -> NDArray[np.bool_]:
        """(R, N) which segment the load acts on."""
        segments = np.arange(1, self.command_rad.shape[1] // 2 + 1)
        return np.asarray(self.load_segment[:, None] == segments)

    def rows(self, chosen: NDArray[Any] | slice) -> Recording:
        """The chosen rows: a mask (R,), indices or a slice."""
        columns = {field.name: getattr(self, field.name) for field in fields(self)[1:]}
        given = {name: column for name, column in columns.items() if column is not None}
        return replace(self, **{name: column[chosen] for name, column in given.items()})


def numbers_a_row(joint_count: int, cable_count: int) -> int:
    """How many numbers a row of a recording has."""
    return 7 + joint_count + cable_count


def given_places(load_at_m: Array | None) -> Array | None:
    """Places (R,) of loads; None where all are NaN."""
    return None if load_at_m is None or np.isnan(load_at_m).all() else load_at_m


def rows_named(wrong: NDArray[Any]) -> str:
    """Marked rows (R,), from 1: `row 7`, `rows 3 to 9 and 12`, `rows 1, 3 … (40 in all)`."""
    rows = np.flatnonzero(wrong) + 1
    if len(rows) == 1:
        return f"row {rows[0]}"
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    named = [f"{run[0]} to {run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs]
    if len(named) > _SHOWN:
        return f"rows {', '.join(named[:_SHOWN])} … ({len(rows)} in all)"
    *first, last = named
    return f"rows {', '.join(first)} and {last}" if first else f"rows {last}"


def derive_trials(
    time_s: Array,
    command_rad: Array,
    load_segment: NDArray[np.int64],
    load_n: Array,
    load_at_m: Array | None = None,
) -> NDArray[np.int64]:
    """Trial (R,) of each row, from 0, of rows as in a `Recording`.

    One begins after a gap in time, where the command starts to move after standing still, and
    where a load starts after a rest, on another segment, at another place or from another side.
    The arm unloaded again belongs to the trial of the load before, which it may still show.
    """
    if len(time_s) == 0:
        return np.zeros(0, dtype=np.int64)
    intervals = np.diff(time_s)
    usual = float(np.median(intervals)) if intervals.size else 0.0
    gap = np.append(False, intervals > max(_GAP_S, _GAP_INTERVALS * usual))
    changed = np.append(False, (np.diff(command_rad, axis=0) != 0.0).any(axis=1))
    # stamps as floats: a move every _STILL_S must not count by their rounding
    moves = changed & (time_s - _last(time_s, changed)[1] > _STILL_S + 1e-6)
    loaded = load_segment > 0
    last, last_s = _last(time_s, loaded)
    size = np.linalg.norm(load_n, axis=1)
    other_side = (load_n * load_n[last]).sum(axis=1) < _SAME_SIDE_COSINE * size * size[last]
    rested = time_s - last_s > _REST_S + 1e-6
    other_place = load_segment != load_segment[last]
    if load_at_m is not None:
        same = np.isclose(load_at_m, load_at_m[last], rtol=0.0, atol=SAME_PLACE_M, equal_nan=True)
        other_place |= ~same
    begins = gap | moves | (loaded & (rested | other_place | other_side))
    begins[0] = False
    return np.cumsum(begins, dtype=np.int64)


def _last(time_s: Array, marked: NDArray[np.bool_]) -> tuple[NDArray[np.int64], Array]:
    """(R,) number and time of the latest marked row before each; 0, long ago, if there is none."""
    rows = np.where(marked, np.arange(len(marked)), -1)
    before = np.append(-1, np.maximum.accumulate(rows)[:-1])
    return np.maximum(before, 0), np.where(before >= 0, time_s[before], -np.inf)
