"""Sequences of samples in memory: tensions along a course, with the contacts that bent them."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.arm import Arm
from cablesense_training.data.errors import DatasetError
from cablesense_training.motion.motion_protocol import MotionProtocol

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sequences:
    """S sequences of T ticks of an arm with N segments and M cables.

    Attributes:
        arm, protocol, seed: what determines them.
        before_rad: (S, W, 2N) set-points before the first tick, from rest to rest, as far as an
            estimator knows them: one that was started later knows of the last alone.
        tension_difference_n: (S, T, M) readings less the unloaded tensions at the set-point: the
            tare of the sequence's start, carried along by the arm's model.
        joint_command_rad, joint_speed_rad_s, joint_acceleration_rad_s2: (S, T, 2N) set-points.
        segment: (S, T) touched segment, 0 for none.
        angle_deg: (S, T) contact angle at the set-point; 0 where nothing touches.
        magnitude_n: (S, T) force; 0 where nothing touches.
    """

    arm: Arm
    protocol: MotionProtocol
    seed: int
    before_rad: Array
    tension_difference_n: Array
    joint_command_rad: Array
    joint_speed_rad_s: Array
    joint_acceleration_rad_s2: Array
    segment: NDArray[np.int64]
    angle_deg: Array
    magnitude_n: Array

    def __len__(self) -> int:
        return len(self.segment)

    @property
    def ticks(self) -> int:
        """Samples in a sequence."""
        return int(self.segment.shape[1])

    @property
    def moving(self) -> NDArray[np.bool_]:
        """(S, T) whether the set-point moves."""
        return np.asarray((self.joint_speed_rad_s != 0.0).any(axis=-1))

    def select(self, rows: Any) -> Sequences:
        """Some of the sequences, in the order given."""
        return replace(self, **{name: getattr(self, name)[rows] for name in ARRAY_NAMES})

    @classmethod
    def concatenate(cls, parts: list[Sequences]) -> Sequences:
        """Parts of one run, in order.

        Raises:
            DatasetError: no parts.
        """
        if not parts:
            raise DatasetError("no sequences: every one of them lay beyond the arm")
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in ARRAY_NAMES
        }
        return replace(parts[0], **arrays)


ARRAY_NAMES = tuple(f.name for f in fields(Sequences) if f.name not in ("arm", "protocol", "seed"))
"""Names of the arrays that have one row per sequence."""
