"""What a demo of the controller records, and the figures that it comes to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_ros.admittance.estimate_watch import Sight

Array = NDArray[np.float64]

STEADY_S = 2.0
"""The end of the contact that the settled force is averaged over."""


@dataclass(frozen=True)
class AdmittanceRecord:
    """A course of K moments.

    Attributes:
        times_s: (K,) since the wall began to move.
        true_n: (K,) force of the wall on the arm.
        unyielding_n: (K,) what the wall would press with, had the arm not been commanded away.
        estimated_n: (K,) the estimator's.
        commands_rad: (K, 2N) commands in force.
        sights: (K,) what could be known of contacts.
        leaves_s: when the wall began to retreat.
    """

    times_s: Array
    true_n: Array
    unyielding_n: Array
    estimated_n: Array
    commands_rad: Array
    sights: tuple[Sight, ...]
    leaves_s: float


def figures(record: AdmittanceRecord, deadband_n: float) -> dict[str, Any]:
    """Forces without and with controller, N, and when the force came to rest, s."""
    pressed = record.times_s < record.leaves_s
    steady = pressed & (record.times_s >= record.leaves_s - STEADY_S)
    settled_n = float(record.true_n[steady].mean())
    touched = np.flatnonzero(pressed & (record.unyielding_n > deadband_n))
    above = np.flatnonzero(pressed & (record.true_n > settled_n + 1.0))
    settling_s = (
        float(record.times_s[above[-1]] - record.times_s[touched[0]])
        if len(above) and len(touched)
        else 0.0
    )
    changed = np.abs(np.diff(record.commands_rad, axis=0)).max(axis=1) > 0.0
    return {
        "without_controller_n": float(record.unyielding_n[steady].mean()),
        "peak_n": float(record.true_n[pressed].max()),
        "settled_n": settled_n,
        "settling_s": settling_s,
        "steps": int(np.count_nonzero(changed & pressed[1:])),
        "left_from_home_deg": float(np.rad2deg(np.abs(record.commands_rad[-1]).max())),
    }
