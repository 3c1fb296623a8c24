"""A straight line through a sensor's readings of known forces, by weighted least squares.

The readings are fitted on the forces, not the forces on the readings, since the forces are the
better known of the two::

    raw_i = zero + force_i / scale + e_i,      weight_i = 1 / (raw_u_i² + (force_u_i / scale)²)

The covariance of zero and slope is s² (Xᵀ W X)⁻¹, with s² = Σ weight_i e_i² / (n - 2). Source:
JCGM 100:2008 (GUM), annex H.3 (a calibration line by least squares) and 5.1 (propagation), with
the t-distribution of G.3. Where uncertainties of the readings were given, s² is at least 1: that
the points lie closer to the line than they should proves nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

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
