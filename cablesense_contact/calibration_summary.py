"""What a calibration says, in a table: which kinds of parameters are known better than before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cablesense_contact.calibration import DETERMINED_SHARE, Calibration
from cablesense_sim.parameter_groups import CARRIED_FRICTION, GroupedParameters


@dataclass(frozen=True)
class KindSummary:
    """Parameters of one kind, for example the stiffness of all cables.

    Attributes:
        kind: `cable_stiffness` and the like.
        unit: of the deviations; `1` for shares.
        count: how many parameters.
        tolerance: one standard deviation before the calibration.
        std: median of the standard deviations after it.
        determined: how many are known to less than `DETERMINED_SHARE` of their tolerance.
        largest: the largest deviation from the arm file, as a multiple of the tolerance.
    """

    kind: str
    unit: str
    count: int
    tolerance: float
    std: float
    determined: int
    largest: float


def summarised(calibration: Calibration, parameters: GroupedParameters) -> list[KindSummary]:
    """One row for each kind of uncertain parameters, in their order.

    Carried friction is left out: it is a state of the last pose. So are parameters without
    tolerance.
    """
    kinds: dict[str, list[int]] = {}
    units = {}
    for group in parameters.groups:
        kind = group.name.rstrip("_0123456789")
        part = parameters.slices[group.name]
        kinds.setdefault(kind, []).extend(range(part.start, part.stop))
        units[kind] = group.unit
    prior_std = np.sqrt(np.diagonal(calibration.prior_covariance))
    rows = []
    for kind, numbers in kinds.items():
        known = np.array([number for number in numbers if prior_std[number] > 0.0], dtype=int)
        if kind == CARRIED_FRICTION or not len(known):
            continue
        before = prior_std[known]
        after = calibration.std[known]
        moved = np.abs(calibration.mean[known] - calibration.prior_mean[known])
        rows.append(
            KindSummary(
                kind=kind,
                unit=units[kind],
                count=len(known),
                tolerance=float(np.median(before)),
                std=float(np.median(after)),
                determined=int((after < DETERMINED_SHARE * before).sum()),
                largest=float((moved / before).max()),
            )
        )
    return rows
