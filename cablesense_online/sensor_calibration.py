"""Scale and zero of a tension sensor from known loads, with uncertainty and characteristics.

Known loads are a CSV file written by hand. Least squares fits a straight line to the readings as a
function of the known forces, because the forces are known better than the readings::

    raw_i = zero + force_i / scale + e_i

The uncertainties are those of JCGM 100:2008 (GUM), annex H.3 (a calibration line by least
squares) and 5.1 (propagation), with the t-distribution of G.3.

Nonlinearity, hysteresis and repeatability are those of VDI/VDE 2638 (characteristics of force
transducers), in N. They refer to the fitted line and to the loads that were applied. The
standard's fixed load steps and mounting positions need a testing machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import Annotated

import numpy as np
from cantools.database.can import Database
from pydantic import Field, ValidationError, model_validator
from scipy.stats import linregress
from scipy.stats import t as student_t

from cablesense_base import Array
from cablesense_base.files import read_bounded_text
from cablesense_base.plain_yaml import Count, FilePart, Number, describe_problem
from cablesense_online.can.channel_map import Channel, ChannelMap, ScaledSensor, signal_conversion
from cablesense_online.sensor_check import CommissioningError
from cablesense_recording.recording import Recording

STANDARD_GRAVITY_M_S2 = 9.80665
"""3rd CGPM (1901)."""
GRAVITY_RELATIVE_U = 0.0015
"""Standard uncertainty of the standard value if the local one is unknown. Normal gravity ranges
from 9.7803 m/s² at the equator to 9.8322 at the poles (WGS 84): half of that over root 3."""
MAX_TABLE_BYTES = 1_000_000
"""Far more than a table written by hand."""
LEAST_CHANGE = 1e-6
"""A smaller relative change of the readings counts as no change."""
FEWEST_POINTS = 5
"""Gives three degrees of freedom; with fewer, the 95 % coverage factor exceeds 4."""
FEWEST_LOADS = 3
"""Two loads cannot show nonlinearity."""
LEAST_SPREAD = 0.5
"""The loads must cover this share of the largest; otherwise the zero is extrapolated far."""
LARGEST_SCALE_U95 = 0.1
"""If the relative uncertainty of the scale is larger, the sensor does not follow the loads."""
FEWEST_SAMPLES = 10
"""Per window; the mean of fewer samples is hardly better than one reading."""

_Time = Annotated[Number, Field(ge=0.0, le=1e7)] | None
"""At most about a hundred days; a larger number is a date."""


class KnownLoad(FilePart):
    """One load on one cable: a row of the table.

    Attributes:
        line: number of the row's line.
        mass_kg, force_n: the load, as one of the two; 0 is the bare cable.
        raw: the sensor's reading in the signal's unit.
        start_s, end_s: in place of `raw`, when the load hung, in the time of a recording.
    """

    line: Count
    cable: str
    mass_kg: Annotated[Number, Field(ge=0.0, le=2_000.0)] | None = None
    force_n: Annotated[Number, Field(ge=0.0, le=20_000.0)] | None = None
    raw: Annotated[Number, Field(ge=-1e11, le=1e11)] | None = None
    start_s: _Time = None
    end_s: _Time = None

    @model_validator(mode="after")
    def _is_one_load_with_one_reading(self) -> KnownLoad:
        if (self.mass_kg is None) == (self.force_n is None):
            raise ValueError("must give one of mass_kg and force_n")
        if (self.start_s is None) != (self.end_s is None):
            raise ValueError("must give both of start_s and end_s, or neither")
        if (self.raw is None) == (self.start_s is None):
            raise ValueError("must give one of raw and start_s")
        return self

    def applied_n(self, gravity_m_s2: float) -> float:
        """Force on the cable, N."""
        return self.force_n or 0.0 if self.mass_kg is None else self.mass_kg * gravity_m_s2


def read_known_loads(path: str | Path, cable_names: Sequence[str]) -> dict[str, list[KnownLoad]]:
    """Known loads by cable, each in the order of application; columns as in `KnownLoad`.

    Empty lines and lines that begin with # are skipped.

    Raises:
        CommissioningError: the file cannot be read as such a table, or a row names no cable of
            `cable_names`, lacks load or reading, or has two of either.
    """
    text = read_bounded_text(path, MAX_TABLE_BYTES, "a table written by hand", CommissioningError)
    table = [
        (number, [cell.strip() for cell in line.split(",")])
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if len(table) < 2:
        columns = ", ".join(name for name in KnownLoad.model_fields if name != "line")
        raise CommissioningError(f"{path}: has no rows; below a header of {columns} it needs some")
    (_, header), *rows = table
    loads: dict[str, list[KnownLoad]] = {}
    for number, cells in rows:
        where = f"{path}: line {number}"
        if len(cells) != len(header):
            raise CommissioningError(f"{where} has {len(cells)} cells, the header {len(header)}")
        named_cells = {column: cell for column, cell in zip(header, cells, strict=True) if cell}
        try:
            load = KnownLoad.model_validate(named_cells | {"line": number})
        except ValidationError as error:
            raise CommissioningError(f"{where}: {describe_problem(error, KnownLoad)}") from None
        if load.cable not in cable_names:
            raise CommissioningError(
                f"{where}: no cable {load.cable[:40]!r}; there are {', '.join(cable_names)}"
            )
        loads.setdefault(load.cable, []).append(load)
    return loads


def raw_reading(load: KnownLoad, as_recorded: ChannelMap, recording: Recording | None) -> float:
    """The sensor's reading of a load, the mean over its window if it has one.

    `as_recorded` is the channel map used for the recording. Its scales and zeros convert the
    tensions back to signal values; its channels are in the recording's order.

    Raises:
        CommissioningError: a window without a recording, or with too few samples in it.
    """
    if load.raw is not None:
        return load.raw
    where = f"load in line {load.line}"
    if recording is None:
        raise CommissioningError(
            f"{where} gives start_s and end_s; give the recording as well, or the reading as raw"
        )
    time_s = recording.time_s
    start_s = load.start_s or 0.0
    end_s = load.end_s or 0.0
    rows = (time_s >= start_s) & (time_s <= end_s)
    if rows.sum() < FEWEST_SAMPLES:
        raise CommissioningError(
            f"{where}: only {rows.sum()} samples of {recording.name} are from {start_s:g} to "
            f"{end_s:g} s; at least {FEWEST_SAMPLES} are needed, and the recording goes "
            f"from {time_s[0]:g} to {time_s[-1]:g} s"
        )
    column = as_recorded.cable_names.index(load.cable)
    tension_n = float(recording.tensions_n[rows, column].mean())
    return as_recorded.channels[load.cable].value(tension_n)


def calibrate_sensor(
    cable: str,
    channel: Channel,
    database: Database,
    force_n: Array,
    raw: Array,
    common_relative_u: float = 0.0,
) -> ScaledSensor:
    """Scale and zero of a cable's sensor, which `channel` of the DBC file `database` reads.

    `force_n` (n,) and `raw` (n,) are in the order in which the loads were applied.
    `common_relative_u` is the relative standard uncertainty that all forces share (gravity,
    gauge, set of weights). It adds to the uncertainty of the scale, and averaging does not reduce
    it.

    Raises:
        CommissioningError: too few points or loads, loads too close together, or readings that
            do not follow the loads.
    """
    _require_enough(cable, force_n)
    low_n = float(force_n.min())
    high_n = float(force_n.max())
    freedom = len(force_n) - 2
    line = linregress(force_n, raw)
    coverage = float(student_t.ppf(0.975, freedom))
    moves = abs(line.slope) * (high_n - low_n) > LEAST_CHANGE * np.abs(raw).max()
    if not moves or coverage * line.stderr > LARGEST_SCALE_U95 * abs(line.slope):
        raise CommissioningError(
            f"{cable}: its readings do not follow the loads along a line; check that the loads "
            f"hung on {cable}, that its sensor is connected to this channel, and the noted values"
        )

    def expanded(fitted_u: float, common_u: float) -> float:
        """By Welch-Satterthwaite (GUM G.4), because the common part is known."""
        combined = float(np.hypot(fitted_u, common_u))
        if fitted_u == 0.0:
            return 1.96 * combined
        effective = freedom * (combined / fitted_u) ** 4
        return float(student_t.ppf(0.975, effective)) * combined

    def force_u_n(at_n: float) -> float:
        """Standard uncertainty of a force from the line; zero and slope have a covariance."""
        covariance = -float(force_n.mean()) * line.stderr**2
        variance = line.intercept_stderr**2 + 2 * at_n * covariance + (at_n * line.stderr) ** 2
        return abs(scale) * float(np.sqrt(max(variance, 0.0)))

    scale = float(1.0 / line.slope)
    unit, factor, offset = signal_conversion(database, channel)
    residual_n = (raw - line.intercept - line.slope * force_n) * scale
    nonlinearity_n, hysteresis_n, repeatability_n = characteristics(force_n, residual_n)
    return ScaledSensor(
        message=channel.message,
        signal=channel.signal,
        signal_unit=unit,
        signal_factor=factor,
        signal_offset=offset,
        scale_n_per_unit=scale,
        scale_u95_n_per_unit=expanded(line.stderr * scale**2, abs(scale) * common_relative_u),
        zero=float(line.intercept),
        zero_u95=expanded(float(line.intercept_stderr), 0.0),
        tension_u95_n=max(
            expanded(force_u_n(end_n), end_n * common_relative_u) for end_n in (low_n, high_n)
        ),
        points=len(force_n),
        largest_force_n=high_n,
        nonlinearity_n=nonlinearity_n,
        hysteresis_n=hysteresis_n,
        repeatability_n=repeatability_n,
    )


def _require_enough(cable: str, force_n: Array) -> None:
    low_n = float(force_n.min())
    high_n = float(force_n.max())
    sizes = len(np.unique(force_n))
    text = ""
    if len(force_n) < FEWEST_POINTS:
        text = f"only {len(force_n)} loads; at least {FEWEST_POINTS} are needed, better ten: up "
        text += "and down again"
    elif sizes < FEWEST_LOADS:
        text = f"loads of only {sizes} sizes; at least {FEWEST_LOADS} are needed for linearity"
    elif high_n - low_n < LEAST_SPREAD * high_n:
        text = f"loads are from {low_n:.4g} to {high_n:.4g} N; they must cover at least half of "
        text += "the largest, better all from the bare cable on, or the zero is a guess"
    if text:
        raise CommissioningError(f"{cable}: {text}")


def characteristics(force_n: Array, residual_n: Array) -> tuple[float, float | None, float | None]:
    """Nonlinearity, hysteresis and repeatability of (n,) loads in the order of application.

    A load reached by adding weight is rising, and a repeated one as the one before it. The
    largest load ends the rising side and starts the falling side, so it shows no hysteresis.
    """
    groups: dict[tuple[float, bool], list[float]] = {}
    rising = True
    before_n = -1.0
    for load_n, off_n in zip(force_n.tolist(), residual_n.tolist(), strict=True):
        rising = rising if load_n == before_n else load_n > before_n
        groups.setdefault((load_n, rising), []).append(off_n)
        before_n = load_n
    means = {key: fmean(offs_n) for key, offs_n in groups.items()}
    up = {load_n: mean_n for (load_n, is_up), mean_n in means.items() if is_up}
    loops = [
        abs(means[load_n, False] - mean_n)
        for load_n, mean_n in up.items()
        if (load_n, False) in means and load_n < max(up)
    ]
    ranges = [max(offs_n) - min(offs_n) for offs_n in groups.values() if len(offs_n) > 1]
    nonlinearity_n = max(abs(mean_n) for mean_n in up.values())
    return nonlinearity_n, max(loops, default=None), max(ranges, default=None)
