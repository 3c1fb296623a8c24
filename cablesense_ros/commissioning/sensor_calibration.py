"""One sensor's scale and zero from known loads, how sure they are, or why they cannot be had."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from cablesense_ros.commissioning.commissioning_error import CommissioningError
from cablesense_ros.commissioning.line_fit import LineFit, fit_line
from cablesense_ros.commissioning.residual_figures import (
    ResidualFigures,
    load_numbers,
    residual_figures,
)

Array = NDArray[np.float64]

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
