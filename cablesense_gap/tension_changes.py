"""Changes of the tensions under loads that are hung on the arm: what a table of loads reports.

A change is a loaded reading less the unloaded one just before it. What is the same in both, such
as a sensor's zero or the arm's own weight, is not in it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.simulator import Array, Assignment, Candidate
from cablesense_sim.arm import Arm
from cablesense_sim.sensors import difference_variance_n2, read_tensions_n

NEED_TIME = frozenset({"cable_creep", "sensor_drift", "sensor_lag"})
"""Effects that act by the time that passes, which a table of changes does not state."""

_HOLD_S = 60.0


@dataclass(frozen=True)
class TensionChanges:
    """K loads hung on the straight arm one after the other, and what each changed.

    Attributes:
        name: of the table.
        load_segment: (K,) 1 to N.
        load_n: (K, 3) the load, base frame, at the segment's contact point.
        changes_n: (K, M) tensions with the load less those without.
    """

    name: str
    load_segment: NDArray[np.int64]
    load_n: Array
    changes_n: Array

    def course(self, joint_count: int) -> Recording:
        """(2K rows) each load hung on the unloaded arm, and taken off for the next."""
        count = len(self.load_segment)
        loaded = np.tile([0, 1], count)
        return Recording(
            name=self.name,
            time_s=np.arange(0.0, 2 * count) * _HOLD_S,
            trial=np.repeat(np.arange(count), 2),
            command_rad=np.zeros((2 * count, joint_count)),
            load_segment=loaded * np.repeat(self.load_segment, 2),
            load_n=loaded[:, None] * np.repeat(self.load_n, 2, axis=0),
            tensions_n=np.zeros((2 * count, self.changes_n.shape[1])),
        )


class ChangeSimulator:
    """A `Simulator` whose K rows are changes under load.

    Attributes: see `Simulator`.
    """

    candidates: Sequence[Candidate]
    tolerances: Sequence[Candidate]
    floor: float

    def __init__(
        self, arm: Arm, changes: TensionChanges, effects: Collection[str] | None = None
    ) -> None:
        """Candidates are those among `effects`, or all; never those that need the time."""
        self._sensors = arm.sensors
        self._arm = ArmSimulator(arm, changes.course(2 * arm.segment_count))
        self.floor = float(np.sqrt(difference_variance_n2(arm.sensors, tare_samples=1)))
        self.candidates = tuple(
            c
            for c in self._arm.candidates
            if c.effect not in NEED_TIME and (effects is None or c.effect in effects)
        )
        self.tolerances = self._arm.tolerances

    def predict(self, variants: Sequence[Assignment]) -> Array:
        """Changes (P, K, M), N, without noise; NaN where the arm finds no rest."""
        return _changes_n(self._arm.predict(variants))

    def measured(
        self, variant: Assignment, rng: np.random.Generator, beyond_n: Array | float = 0.0
    ) -> Array:
        """Changes (K, M) as sensors would tell them, N: each reading has its own noise and step.

        `beyond_n` (K, M) is added to the loaded tensions: what no effect of the library does.
        """
        tensions = self._arm.predict([variant])[0]
        tensions[1::2] += beyond_n
        return _changes_n(read_tensions_n(tensions, self._sensors, rng))


def _changes_n(readings_n: Array) -> Array:
    return np.asarray(readings_n[..., 1::2, :] - readings_n[..., 0::2, :])
