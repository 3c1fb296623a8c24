"""Several arms of one kind as one mechanism whose numbers have a leading axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.mechanism import Mechanism

Array = NDArray[np.float64]

_STACKED = (
    "gravity_m_s2",
    "mass_kg",
    "centre_of_mass_m",
    "contact_m",
    "hole_y_m",
    "hole_z_m",
    "stiffness_n_m",
    "pretension_n",
    "joint_stiffness_n_m_rad",
)


def stack(mechanisms: Sequence[Mechanism]) -> Mechanism:
    """Mechanisms of one kind as one whose arrays have a leading axis P."""
    fields: dict[str, Any] = {
        name: np.stack([getattr(m, name) for m in mechanisms]) for name in _STACKED
    }
    if any(m.segment_hole_y_m is not None for m in mechanisms):
        shape = (mechanisms[0].cable_count, mechanisms[0].segment_count)
        for name in ("y", "z"):
            fields[f"segment_hole_{name}_m"] = np.stack(
                [np.broadcast_to(_plates(m, name), shape) for m in mechanisms]
            )
    return replace(mechanisms[0], **fields)


def _plates(mechanism: Mechanism, axis: str) -> Array:
    plates = getattr(mechanism, f"segment_hole_{axis}_m")
    if plates is None:
        plates = getattr(mechanism, f"hole_{axis}_m")[:, None]
    return np.asarray(plates)
