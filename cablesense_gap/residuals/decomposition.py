"""A residual taken apart by place, regime and time, each part beside the noise floor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.recordings.recording import Recording
from cablesense_gap.residuals.cable_sets import MODES, set_modes_n
from cablesense_gap.residuals.load_branch import loop_n
from cablesense_gap.residuals.part import Part, measure
from cablesense_gap.residuals.row_groups import row_groups
from cablesense_sim.arm import Arm

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

ALL, CABLE, SET, LOOP = "all", "cable", "cable set", "hysteresis"


@dataclass(frozen=True)
class Decomposition:
    """The parts of one residual, and the noise floor they stand beside."""

    parts: tuple[Part, ...]
    floor_n: float

    @property
    def rms_n(self) -> float:
        """Of the whole residual."""
        return self.of_group(ALL)[0].rms_n

    def of_group(self, group: str) -> tuple[Part, ...]:
        """The members of one group."""
        return tuple(part for part in self.parts if part.group == group)

    def table(self) -> pd.DataFrame:
        """One row a part, columns as in `Part`."""
        import pandas as pd

        return pd.DataFrame([asdict(part) for part in self.parts])


def decompose(recording: Recording, residual_n: Array, floor_n: float, arm: Arm) -> Decomposition:
    """Take a residual (R, M), measured less predicted, apart; NaN is left out.

    `floor_n` is the root mean square that a perfect model would leave in one reading.

    Raises:
        ValueError: the residual is of other shape than the readings, or has no number at all.
    """
    if residual_n.shape != recording.tensions_n.shape:
        raise ValueError(
            f"the residual is {residual_n.shape}, the readings are {recording.tensions_n.shape}"
        )
    measured = (
        measure(group, member, values, floor_n)
        for group, member, values in _pieces(recording, residual_n, arm)
    )
    parts = tuple(part for part in measured if part is not None)
    if not parts:
        raise ValueError("the residual has no number that is finite")
    return Decomposition(parts, floor_n)


def _pieces(recording: Recording, residual_n: Array, arm: Arm) -> Iterator[tuple[str, str, Array]]:
    yield ALL, "all", residual_n
    for name, column in zip(arm.cable_names, residual_n.T, strict=True):
        yield CABLE, name, column[:, None]
    modes = set_modes_n(residual_n, arm)
    for n in range(arm.segment_count):
        for mode, name in enumerate(MODES):
            yield SET, f"segment_{n + 1}, {name}", modes[:, n, mode, None]
    yield LOOP, "half the width of the loop", loop_n(recording, residual_n)
    for group, member, rows in row_groups(recording):
        yield group, member, residual_n[rows]
