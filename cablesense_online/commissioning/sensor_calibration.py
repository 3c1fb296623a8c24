"""Scale and zero of a tension sensor from known loads, with uncertainty and characteristics.

Weighted least squares fits a straight line to the readings as a function of the known forces,
because the forces are known better than the readings::

    raw_i = zero + force_i / scale + e_i,      weight_i = 1 / (raw_u_i² + (force_u_i / scale)²)

The covariance of zero and slope is s² (Xᵀ W X)⁻¹, with s² = Σ weight_i e_i² / (n - 2). Source:
JCGM 100:2008 (GUM), annex H.3 (a calibration line by least squares) and 5.1 (propagation), with
the t-distribution of G.3. If uncertainties of the readings are given, s² is at least 1, because
a small scatter can be chance.

Nonlinearity, hysteresis and repeatability are those of VDI/VDE 2638 (characteristics of force
transducers), in N. They refer to the fitted line and to the loads that were applied. The
standard's fixed load steps and mounting positions need a testing machine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any, NamedTuple

import numpy as np
from cantools.database.can import Database
from numpy.typing import NDArray
from scipy.stats import t as student_t

from cablesense_base import Array
from cablesense_gap.recordings.recording import Recording
from cablesense_online.can.calibration import CalibratedSensor, Calibration
from cablesense_online.can.channel_map import ChannelMap, signal_conversion
from cablesense_online.commissioning.tables import CommissioningError, KnownLoad

LEAST_CHANGE = 1e-6
"""A smaller relative change of the readings counts as no change."""
LARGEST_SCALE_N_PER_UNIT = 1e9
"""The same limit as in channel maps."""
SAME_FORCE = 0.005
"""Forces that differ by less than this share of the largest are the same load, repeated."""
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
_WEIGHT_ROUNDS = 4
"""The weights depend weakly on the slope; it converges after two rounds."""


class CalibrationPoint(NamedTuple):
    """A known force on a cable, its sensor's reading, and their standard uncertainties (or 0)."""

    force_n: float
    raw: float
    force_u_n: float = 0.0
    raw_u: float = 0.0


@dataclass(frozen=True)
class SensorCalibration:
    """`tension_n = scale_n_per_unit * (raw - zero)`, with expanded uncertainties (95 %).

    Attributes:
        scale_n_per_unit, scale_u95_n_per_unit: newtons of one unit of the signal.
        zero, zero_u95: the signal without tension.
        tension_u95_n: largest uncertainty of a tension within the range of the loads.
        largest_residual_n, largest_residual_at: residual and index of the point furthest from
            the line.
        points, largest_force_n: number of loads, and the largest.
        nonlinearity_n: largest distance of a rising load's mean reading from the line.
        hysteresis_n: largest difference of mean readings between falling and rising at one load;
            none if the loads do not show it.
        repeatability_n: largest range of readings at one load, reached from one side; or none.
    """

    scale_n_per_unit: float
    scale_u95_n_per_unit: float
    zero: float
    zero_u95: float
    tension_u95_n: float
    largest_residual_n: float
    largest_residual_at: int
    points: int
    largest_force_n: float
    nonlinearity_n: float
    hysteresis_n: float | None
    repeatability_n: float | None


def calibration_point(
    load: KnownLoad, as_recorded: ChannelMap, recording: Recording | None
) -> CalibrationPoint:
    """The point of a load, with the mean reading where it has a window in a recording.

    `as_recorded` is the channel map used for the recording. Its scales and zeros convert the
    tensions back to signal values; its channels are in the recording's order.

    Raises:
        CommissioningError: a window without a recording, or with too few samples in it.
    """
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


def calibrate_sensor(
    cable: str, points: Sequence[CalibrationPoint], common_relative_u: float = 0.0
) -> SensorCalibration:
    """Scale and zero of a cable's sensor.

    Points are in the order in which the loads were applied. `common_relative_u` is the relative
    standard uncertainty that all forces share (gravity, gauge, set of weights). It adds to the
    uncertainty of the scale, and averaging does not reduce it.

    Raises:
        CommissioningError: too few points or loads, loads too close together, uncertainties for
            some points only, or readings that do not follow the loads.
    """
    force_n, raw, force_u_n, raw_u = np.array(points).T
    low_n, high_n = float(force_n.min()), float(force_n.max())
    sizes, given = int(load_numbers(force_n).max()) + 1, np.count_nonzero(raw_u)
    for refused, text in (
        (
            len(points) < FEWEST_POINTS,
            f"only {len(points)} loads; at least {FEWEST_POINTS} are needed, better ten: up and "
            "down again",
        ),
        (
            sizes < FEWEST_LOADS,
            f"loads of only {sizes} size{'s' * (sizes > 1)}; at least {FEWEST_LOADS} are needed, "
            "or linearity cannot be judged",
        ),
        (
            high_n - low_n < LEAST_SPREAD * high_n,
            f"loads lie from {low_n:.4g} to {high_n:.4g} N; they must cover at least half of the "
            "largest, better all from the bare cable on, or the zero is guessed",
        ),
        (
            0 < given < len(points) or (force_u_n.any() and not raw_u.all()),
            f"raw_u is given for {given} of {len(points)} loads; give it for all or none, and for "
            "all where the loads' own uncertainty is given",
        ),
    ):
        if refused:
            raise CommissioningError(f"{cable}: {text}")
    line = fit_line(force_n, raw, force_u_n, raw_u)
    factor = float(student_t.ppf(0.975, len(points) - 2))
    if line is None or (
        factor * line.scale_u_n_per_unit > LARGEST_SCALE_U95 * abs(line.scale_n_per_unit)
    ):
        raise CommissioningError(
            f"{cable}: its readings do not follow the loads along a line; see that the loads hung "
            f"on {cable}, that its sensor is connected to this channel, and that none was "
            "noted wrongly"
        )
    scale, worst = line.scale_n_per_unit, int(np.argmax(np.abs(line.residual_n)))
    scale_u = line.scale_u_n_per_unit
    tension_u95_n = [
        _expanded(line.force_u_n(end), end * common_relative_u, line) for end in (low_n, high_n)
    ]
    return SensorCalibration(
        scale_n_per_unit=scale,
        scale_u95_n_per_unit=_expanded(scale_u, abs(scale) * common_relative_u, line),
        zero=line.zero,
        zero_u95=_expanded(line.zero_u, 0.0, line),
        tension_u95_n=max(tension_u95_n),
        largest_residual_n=float(line.residual_n[worst]),
        largest_residual_at=worst,
        points=len(points),
        largest_force_n=high_n,
        **residual_characteristics(force_n, line.residual_n),
    )


def calibration_record(
    found: Mapping[str, SensorCalibration],
    channel_map: ChannelMap,
    database: Database,
    made: datetime,
    gravity_m_s2: float | None,
    common_relative_u: float,
) -> Calibration:
    """The calibration file's content; cables of the map without a result are uncalibrated.

    Gravity is none if no load was given as a mass.
    """
    cables = {}
    uncalibrated = []
    for cable, channel in channel_map.channels.items():
        if cable not in found:
            uncalibrated.append(cable)
            continue
        values = asdict(found[cable])
        unit, factor, offset = signal_conversion(database, channel)
        cables[cable] = CalibratedSensor(
            message=channel.message,
            signal=channel.signal,
            signal_unit=unit,
            signal_factor=factor,
            signal_offset=offset,
            **{name: values[name] for name in values if name in CalibratedSensor.model_fields},
        )
    return Calibration(
        map=channel_map.name,
        made=made,
        gravity_m_s2=gravity_m_s2,
        common_relative_u=common_relative_u,
        uncalibrated=tuple(uncalibrated),
        cables=cables,
    )


@dataclass(frozen=True)
class LineFit:
    """A sensor's line: `force_n = scale_n_per_unit * (raw - zero)`.

    Attributes:
        scale_n_per_unit, zero: newtons of one unit of the signal; the signal without force.
        covariance: (2, 2) of zero and slope, slope being 1 / scale.
        degrees_of_freedom: points less the two that were fitted.
        residual_n: (n,) readings as forces, less the known forces.
    """

    scale_n_per_unit: float
    zero: float
    covariance: Array
    degrees_of_freedom: int
    residual_n: Array

    @property
    def zero_u(self) -> float:
        """Standard uncertainty of the zero, in the signal's unit."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def scale_u_n_per_unit(self) -> float:
        """Standard uncertainty of the scale, without the part that all forces share."""
        return float(np.sqrt(self.covariance[1, 1])) * self.scale_n_per_unit**2

    def force_u_n(self, force_n: float) -> float:
        """Standard uncertainty of a force read from the line, without the shared part."""
        by = np.array([1.0, force_n])
        return float(np.sqrt(by @ self.covariance @ by)) * abs(self.scale_n_per_unit)


def fit_line(force_n: Array, raw: Array, force_u_n: Array, raw_u: Array) -> LineFit | None:
    """Fit `raw` (n,) readings, in any unit, to known forces; none if they do not follow.

    `force_n` (n,), at least two of them different. `force_u_n` and `raw_u` (n,) are standard
    uncertainties, 0 if unknown; if all are 0, all points have the same weight.
    """
    given = bool((force_u_n > 0.0).any() or (raw_u > 0.0).any())
    weight = np.ones_like(force_n)
    slope, zero = np.polyfit(force_n, raw, 1)
    for _ in range(_WEIGHT_ROUNDS if given else 0):
        weight = 1.0 / (raw_u**2 + (slope * force_u_n) ** 2)
        slope, zero = np.polyfit(force_n, raw, 1, w=np.sqrt(weight))
    if (
        abs(slope) * LARGEST_SCALE_N_PER_UNIT < 1.0
        or abs(slope) * np.ptp(force_n) <= LEAST_CHANGE * np.abs(raw).max()
    ):
        return None
    error = raw - (zero + slope * force_n)
    freedom = len(raw) - 2
    variance = float((weight * error**2).sum()) / freedom
    if given:
        variance = max(1.0, variance)
    design = np.stack([np.ones_like(force_n), force_n], axis=1)
    covariance = variance * np.linalg.inv(design.T @ (design * weight[:, None]))
    return LineFit(float(1.0 / slope), float(zero), np.asarray(covariance), freedom, error / slope)


def residual_characteristics(force_n: Array, residual_n: Array) -> dict[str, Any]:
    """Nonlinearity, hysteresis and repeatability of (n,) loads in the order of application.

    The largest load ends the rising side and starts the falling side, so it shows no hysteresis.
    """
    means: dict[tuple[int, bool], float] = {}
    ranges = []
    loads = load_numbers(force_n)
    rising = np.ones(len(loads), dtype=bool)  # reached by adding weight, or put on again
    for at, step in enumerate(np.diff(loads).tolist(), start=1):
        rising[at] = rising[at - 1] if step == 0 else step > 0
    top = int(loads[int(np.argmax(force_n))])
    for load in np.unique(loads).tolist():
        for up in (True, False):
            chosen = (loads == load) & (rising == up)
            if chosen.any():
                means[load, up] = float(residual_n[chosen].mean())
            if chosen.sum() > 1:
                ranges.append(float(np.ptp(residual_n[chosen])))
    on_the_way_up = [mean for (_, up), mean in means.items() if up]
    loops = [
        abs(mean - means[load, True])
        for (load, up), mean in means.items()
        if not up and load != top and (load, True) in means
    ]
    return {
        "nonlinearity_n": max(abs(mean) for mean in on_the_way_up or means.values()),
        "hysteresis_n": max(loops, default=None),
        "repeatability_n": max(ranges, default=None),
    }


def load_numbers(force_n: Array) -> NDArray[np.int64]:
    """(n,) which of the different loads each is, from 0 for the smallest."""
    order = np.argsort(force_n, kind="stable")
    new = np.diff(force_n[order]) > SAME_FORCE * max(float(force_n.max()), 1e-12)
    numbers = np.empty(len(force_n), dtype=np.int64)
    numbers[order] = np.concatenate([[0], np.cumsum(new)])
    return numbers


def _expanded(fitted_u: float, common_u: float, line: LineFit) -> float:
    """Expanded uncertainty, 95 %: Welch-Satterthwaite (GUM G.4), the common part being known."""
    combined = float(np.hypot(fitted_u, common_u))
    if fitted_u == 0.0:
        return 1.96 * combined
    freedom = line.degrees_of_freedom * (combined / fitted_u) ** 4
    return float(student_t.ppf(0.975, freedom)) * combined
