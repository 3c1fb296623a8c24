"""The part of a recording that the recording of the healthy machine covers.

A reading is covered if the reference tells as much of its residual as one reading there would:
with columns x of the regression, coefficients of covariance Σ, the variance s² of what does not
repeat, and c readings in turn that count as one (`CORRELATED`),

    xᵀ Σ x ≤ c s²

so c s² / (xᵀ Σ x) counts the readings that the reference is worth there. Elsewhere the floor of
that reading is mostly extrapolated. Beyond the reference's positions, speeds, loads and
accelerations the variance of all that repeats comes in addition (`diagnosis.discrepancy`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.diagnosis.discrepancy import Conditions, ConditionUnits, SmoothColumns
from cablesense_gap.verdict import ChannelCoverage, Lacking, Quantity, listed

_COUNTED_SHARE = 0.5
"""Share of what counts before the low-pass from which on a reading has conditions."""
_RANGE_QUANTILES = 0.05, 0.95
"""Quantiles of conditions that a recording is said to have."""


@dataclass(frozen=True)
class Coverage:
    """Which readings (R, C) of a recording its reference covers.

    Attributes:
        covered: (R, C).
        by_channel: share of its readings that is covered, and lacking quantities, by name.
        share: of all readings.
    """

    covered: NDArray[np.bool_]
    by_channel: Mapping[str, ChannelCoverage]
    share: float

    @property
    def uncovered_channels(self) -> dict[str, ChannelCoverage]:
        """The channels whose floor is mostly extrapolated, by name."""
        return {name: each for name, each in self.by_channel.items() if not each.is_mostly_covered}

    @property
    def experiment(self) -> str:
        """The recording of the healthy machine that the uncovered channels need, as text."""
        wanted = [
            f"{name} {_range_text(channel)}" for name, channel in self.uncovered_channels.items()
        ]
        return (
            "Record this motion when the machine is healthy, and give that as the reference: "
            f"{'; '.join(wanted)}."
        )


def coverage_of(
    covered: NDArray[np.bool_],
    counts: Array,
    conditions: Conditions | None,
    reference: SmoothColumns | None,
    units: Sequence[ConditionUnits],
) -> Coverage:
    """The coverage of readings (R, C).

    `counts` (R, C) says how much of each reading counts, 0 to 1. `conditions` are those of the
    readings, (R, C) each; `reference` has the ranges of the reference's.
    """
    by_channel = {}
    for c, channel_units in enumerate(units):
        lacking: tuple[Lacking, ...] = ()
        uncovered = ~covered[:, c] & (counts[:, c] > _COUNTED_SHARE)
        if conditions is not None and reference is not None and uncovered.any():
            lacking = tuple(_lacking(conditions, reference, uncovered, c, channel_units))
        share = _share(covered[:, c], counts[:, c])
        by_channel[channel_units.name] = ChannelCoverage(share=share, lacking=lacking)
    return Coverage(covered, by_channel, _share(covered, counts))


def _share(covered: NDArray[np.bool_], counts: Array) -> float:
    whole = float(counts.sum())
    return min(float(counts[covered].sum()) / whole, 1.0) if whole > 0.0 else 1.0


def _lacking(
    conditions: Conditions,
    reference: SmoothColumns,
    uncovered: NDArray[np.bool_],
    c: int,
    units: ConditionUnits,
) -> Iterator[Lacking]:
    """The conditions of uncovered readings that leave the reference's range by a margin."""
    beyond = reference.beyond(conditions)
    for name in get_args(Quantity):
        margins = getattr(beyond, name)[uncovered, c]
        if np.quantile(margins, _RANGE_QUANTILES[1]) < 1.0:
            continue
        least, most = np.quantile(
            getattr(conditions, name)[uncovered, c], _RANGE_QUANTILES
        ).tolist()
        low = float(getattr(reference.low, name)[c])
        high = float(getattr(reference.high, name)[c])
        yield Lacking(
            quantity=name, unit=getattr(units, name), recorded=(least, most), reference=(low, high)
        )


def _range_text(channel: ChannelCoverage) -> str:
    """`at positions of 0.2 to 1.5 rad (the reference has -1.2 to 0.1)`, or another reason."""
    ranges = [
        f"{each.quantity}s of {each.recorded[0]:.2g} to {each.recorded[1]:.2g} {each.unit} "
        f"(the reference has {each.reference[0]:.2g} to {each.reference[1]:.2g})"
        for each in channel.lacking
    ]
    if ranges:
        return f"at {listed(ranges)}"
    return f"in the poses of this recording, of which the reference covers {channel.share:.0%}"
