"""One sensor's scale and zero from known loads, how sure they are, or why they cannot be had.

A straight line through a sensor's readings of known forces, by weighted least squares.

The readings are fitted on the forces, not the forces on the readings, since the forces are the
better known of the two::

    raw_i = zero + force_i / scale + e_i,      weight_i = 1 / (raw_u_i² + (force_u_i / scale)²)

The covariance of zero and slope is s² (Xᵀ W X)⁻¹, with s² = Σ weight_i e_i² / (n - 2). Source:
JCGM 100:2008 (GUM), annex H.3 (a calibration line by least squares) and 5.1 (propagation), with
the t-distribution of G.3. Where uncertainties of the readings were given, s² is at least 1: that
the points lie closer to the line than they should proves nothing.

What a straight line leaves of a sensor: nonlinearity, hysteresis, repeatability.

The terms are those of VDI/VDE 2638 (characteristics of force transducers) and are given in N here.
The reference line is the fitted one, and the loads are those that there were; the standard's own
procedure, with its fixed load steps and mounting positions, is for a testing machine.

Calibrated sensors as the calibration that the driver reads.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import Enum

import numpy as np
from cantools.database.can import Database
from numpy.typing import NDArray
from scipy.stats import t as student_t

from cablesense_base.arrays import Array
from cablesense_online.can.calibration import CalibratedSensor, Calibration
from cablesense_online.can.channel_map import Channel, ChannelMap, channel_signal
from cablesense_online.commissioning.readings import CommissioningError

LEAST_CHANGE = 1e-6
"""Readings that change by less than this share of the largest do not change: noise is more."""

LARGEST_SCALE_N_PER_UNIT = 1e9
"""As of channel maps."""

_WEIGHT_ROUNDS = 4
"""The weights depend on the slope so weakly that it stands after two."""


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
        """Standard uncertainty of the scale, without what all forces have in common."""
        return float(np.sqrt(self.covariance[1, 1])) * self.scale_n_per_unit**2

    def force_u_n(self, force_n: float) -> float:
        """Standard uncertainty that the line gives a force, likewise."""
        by = np.array([1.0, force_n])
        return float(np.sqrt(by @ self.covariance @ by)) * abs(self.scale_n_per_unit)


def fit_line(force_n: Array, raw: Array, force_u_n: Array, raw_u: Array) -> LineFit | None:
    """Fit; none where the readings do not change with the force.

    Args:
        force_n: (n,) known forces, at least two of them different.
        raw: (n,) readings, in any unit.
        force_u_n: (n,) standard uncertainties of the forces, 0 where unknown.
        raw_u: (n,) those of the readings; where both are all 0, every point counts the same.
    """
    given = bool((force_u_n > 0.0).any() or (raw_u > 0.0).any())
    design = np.stack([np.ones_like(force_n), force_n], axis=1)
    weight = np.ones_like(force_n)
    coefficients = _solve(design, raw, weight)
    if given:
        for _ in range(_WEIGHT_ROUNDS):
            weight = 1.0 / (raw_u**2 + (coefficients[1] * force_u_n) ** 2)
            coefficients = _solve(design, raw, weight)
    zero, slope = float(coefficients[0]), float(coefficients[1])
    if (
        abs(slope) * LARGEST_SCALE_N_PER_UNIT < 1.0
        or abs(slope) * np.ptp(force_n) <= LEAST_CHANGE * np.abs(raw).max()
    ):
        return None
    error = raw - design @ coefficients
    freedom = len(raw) - 2
    variance = float((weight * error**2).sum()) / freedom
    if given:
        variance = max(1.0, variance)
    weighted = design * weight[:, None]
    covariance = np.asarray(variance * np.linalg.inv(design.T @ weighted), dtype=np.float64)
    return LineFit(1.0 / slope, zero, covariance, freedom, error / slope)


def _solve(design: Array, raw: Array, weight: Array) -> Array:
    root = np.sqrt(weight)
    solved = np.linalg.lstsq(design * root[:, None], raw * root, rcond=None)[0]
    return np.asarray(solved, dtype=np.float64)


SAME_FORCE = 0.005
"""Forces that differ by less than this share of the largest are one load put on again."""


class Direction(Enum):
    """Whether a load was reached by adding weight or by taking weight away."""

    RISING = "rising"
    FALLING = "falling"


@dataclass(frozen=True)
class ResidualFigures:
    """All in N; none where the loads do not show it.

    Attributes:
        nonlinearity_n: largest distance of a rising load's mean reading from the line.
        hysteresis_n: largest difference of mean readings between falling and rising at one load.
        repeatability_n: largest range of readings at one load, reached from one side.
    """

    nonlinearity_n: float
    hysteresis_n: float | None
    repeatability_n: float | None


def residual_figures(force_n: Array, residual_n: Array) -> ResidualFigures:
    """The figures of (n,) loads in the order they were put on, and what the line leaves of each.

    The largest load belongs to both sides, as the end of one and the start of the other.
    """
    means: dict[tuple[int, Direction], float] = {}
    ranges = []
    loads = load_numbers(force_n)
    directions = _directions(force_n)
    top = int(loads[int(np.argmax(force_n))])
    for load in np.unique(loads).tolist():
        for direction in Direction:
            chosen = (loads == load) & np.array([d is direction for d in directions])
            if chosen.any():
                means[load, direction] = float(residual_n[chosen].mean())
            if chosen.sum() > 1:
                ranges.append(float(np.ptp(residual_n[chosen])))
    rising = [mean for (_, direction), mean in means.items() if direction is Direction.RISING]
    loops = [
        abs(mean - means[load, Direction.RISING])
        for (load, direction), mean in means.items()
        if direction is Direction.FALLING and load != top and (load, Direction.RISING) in means
    ]
    return ResidualFigures(
        nonlinearity_n=max(abs(mean) for mean in rising or means.values()),
        hysteresis_n=max(loops, default=None),
        repeatability_n=max(ranges, default=None),
    )


def load_numbers(force_n: Array) -> NDArray[np.int64]:
    """(n,) which of the different loads each is, from 0 for the smallest."""
    order = np.argsort(force_n, kind="stable")
    new = np.diff(force_n[order]) > SAME_FORCE * max(float(force_n.max()), 1e-12)
    numbers = np.empty(len(force_n), dtype=np.int64)
    numbers[order] = np.concatenate([[0], np.cumsum(new)])
    return numbers


def _directions(force_n: Array) -> list[Direction]:
    loads = load_numbers(force_n)
    found = [Direction.RISING]
    for step in np.diff(loads).tolist():
        if step == 0:
            found.append(found[-1])
        else:
            found.append(Direction.RISING if step > 0 else Direction.FALLING)
    return found


FEWEST_POINTS = 5
"""Three degrees of freedom: with fewer the factor of 95 % exceeds 4."""
FEWEST_LOADS = 3
"""Two loads make any sensor straight."""
LEAST_SPREAD = 0.5
"""The loads must cover this share of the largest, or the zero is far outside of them."""
LARGEST_SCALE_U95 = 0.1
"""A scale that is known no better than to this share is none: the sensor does not follow."""


@dataclass(frozen=True)
class CalibrationPoint:
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
        tension_u95_n: of a tension within the loads, where it is largest.
        largest_residual_n, largest_residual_at: the point furthest from the line, from 0.
        points, largest_force_n: how many loads, and up to where.
        figures: what the line leaves.
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
    figures: ResidualFigures


def calibrate_sensor(
    cable: str, points: Sequence[CalibrationPoint], common_relative_u: float = 0.0
) -> SensorCalibration:
    """Scale and zero of a cable's sensor.

    Args:
        cable: its name, for errors.
        points: in the order the loads were put on.
        common_relative_u: relative standard uncertainty that all forces share (gravity, the gauge
            or set of weights); it goes to the scale and no averaging lessens it.

    Raises:
        CommissioningError: too few points or loads, loads too close together, uncertainties for
            some points only, or readings that do not follow the loads.
    """
    force_n = np.array([point.force_n for point in points])
    raw = np.array([point.raw for point in points])
    force_u_n = np.array([point.force_u_n for point in points])
    raw_u = np.array([point.raw_u for point in points])
    _check_loads(cable, force_n)
    if 0 < np.count_nonzero(raw_u) < len(points) or (force_u_n.any() and not raw_u.all()):
        raise CommissioningError(
            f"{cable}: raw_u is given for {np.count_nonzero(raw_u)} of {len(points)} loads; give "
            "it for all or none, and for all where the loads' own uncertainty is given"
        )
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
    scale = line.scale_n_per_unit
    ends_n = (float(force_n.min()), float(force_n.max()))
    worst = int(np.argmax(np.abs(line.residual_n)))
    return SensorCalibration(
        scale_n_per_unit=scale,
        scale_u95_n_per_unit=_expanded(
            line.scale_u_n_per_unit, abs(scale) * common_relative_u, line
        ),
        zero=line.zero,
        zero_u95=_expanded(line.zero_u, 0.0, line),
        tension_u95_n=max(
            _expanded(line.force_u_n(end), end * common_relative_u, line) for end in ends_n
        ),
        largest_residual_n=float(line.residual_n[worst]),
        largest_residual_at=worst,
        points=len(points),
        largest_force_n=ends_n[1],
        figures=residual_figures(force_n, line.residual_n),
    )


def _expanded(fitted_u: float, common_u: float, line: LineFit) -> float:
    """Expanded uncertainty, 95 %: Welch-Satterthwaite (GUM G.4), the common part being known."""
    combined = float(np.hypot(fitted_u, common_u))
    if fitted_u == 0.0:
        return 1.96 * combined
    freedom = line.degrees_of_freedom * (combined / fitted_u) ** 4
    return float(student_t.ppf(0.975, freedom)) * combined


def _check_loads(cable: str, force_n: Array) -> None:
    if len(force_n) < FEWEST_POINTS:
        raise CommissioningError(
            f"{cable}: only {len(force_n)} loads; at least {FEWEST_POINTS} are needed, better "
            "ten: up and down again"
        )
    loads = int(load_numbers(force_n).max()) + 1
    if loads < FEWEST_LOADS:
        raise CommissioningError(
            f"{cable}: loads of only {loads} size{'s' * (loads > 1)}; at least {FEWEST_LOADS} are "
            "needed, or nobody can see whether the sensor is straight"
        )
    low, high = float(force_n.min()), float(force_n.max())
    if high - low < LEAST_SPREAD * high:
        raise CommissioningError(
            f"{cable}: loads lie from {low:.4g} to {high:.4g} N; they must cover at least half of "
            "the largest, better all from the bare cable on, or the zero is guessed"
        )


def calibration_record(
    found: Mapping[str, SensorCalibration],
    channel_map: ChannelMap,
    database: Database,
    made: datetime,
    gravity_m_s2: float | None,
    common_relative_u: float,
) -> Calibration:
    """The calibration of a map's sensors; cables that were not calibrated are listed as such.

    Args:
        found: by cable.
        channel_map: the map of their channels.
        database: its DBC file, whose units and factors are noted.
        made: when.
        gravity_m_s2: with which masses were taken for forces; none where there were no masses.
        common_relative_u: relative standard uncertainty that all loads shared.
    """
    return Calibration(
        map=channel_map.name,
        made=made,
        gravity_m_s2=gravity_m_s2,
        common_relative_u=common_relative_u,
        uncalibrated=[cable for cable in channel_map.channels if cable not in found],
        cables={
            cable: _sensor(found[cable], channel, database)
            for cable, channel in channel_map.channels.items()
            if cable in found
        },
    )


def _sensor(found: SensorCalibration, channel: Channel, database: Database) -> CalibratedSensor:
    signal = channel_signal(database, channel)
    return CalibratedSensor(
        message=channel.message,
        signal=channel.signal,
        signal_unit=signal.unit,
        signal_factor=signal.factor,
        signal_offset=signal.offset,
        scale_n_per_unit=found.scale_n_per_unit,
        zero=found.zero,
        scale_u95_n_per_unit=found.scale_u95_n_per_unit,
        zero_u95=found.zero_u95,
        tension_u95_n=found.tension_u95_n,
        points=found.points,
        largest_force_n=found.largest_force_n,
        nonlinearity_n=found.figures.nonlinearity_n,
        hysteresis_n=found.figures.hysteresis_n,
        repeatability_n=found.figures.repeatability_n,
    )
