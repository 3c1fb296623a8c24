"""The cable over a cylinder, from rest to rest: this project's own friction on Fig. 3 (c)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from cablesense_paper.cables.one_metre_cable import (
    AXIAL_RIGIDITY_N,
    LENGTH_M,
    PRETENSION_N,
    STICK_STIFFNESS_N_M,
)
from cablesense_sim.effects.dry_contact import DryContact

Array = NDArray[np.float64]

_HALF_STIFFNESS_N_M = AXIAL_RIGIDITY_N / (0.5 * LENGTH_M)
_ROUNDING_M = 1e-15


def rubbing_tensions_n(course_m: Array, coefficient: float, wrap_rad: float) -> Array:
    """Tensions (T, 2) before and beyond the cylinder along a course (T,) of the drive.

    Where the cable has passed over the cylinder by s, T1 = T0 + k (c - s) and T2 = T0 + k s with
    c the course and k of half the cable; friction holds T1 = T2 exp(μ θ share(s)), the share of
    its limit after `cablesense_sim.effects.dry_contact`, as the effect `capstan_friction` does.
    The contact gives as much before it slips as the friction of `rubbing_cable` does.
    """
    friction_rad = coefficient * wrap_rad
    give_m = max(friction_rad, 1e-6) * PRETENSION_N / STICK_STIFFNESS_N_M
    none = np.zeros(1)
    contact = DryContact(np.array([give_m]), none, none, none)
    tensions = np.empty((len(course_m), 2))

    def missing_n(passed_m: float, drawn_m: float) -> float:
        share = contact.share(np.array([passed_m]))[0][0]
        near, far = _halves_n(passed_m, drawn_m)
        return float(near - far * np.exp(friction_rad * share))

    slack_m = PRETENSION_N / _HALF_STIFFNESS_N_M
    for row, drawn_m in enumerate(course_m):
        passed_m = brentq(missing_n, -slack_m, drawn_m + slack_m, (drawn_m,), xtol=_ROUNDING_M)
        contact.settle(np.array([passed_m]))
        tensions[row] = _halves_n(passed_m, drawn_m)
    return tensions


def _halves_n(passed_m: float, drawn_m: float) -> tuple[float, float]:
    near = PRETENSION_N + _HALF_STIFFNESS_N_M * (drawn_m - passed_m)
    return near, PRETENSION_N + _HALF_STIFFNESS_N_M * passed_m
