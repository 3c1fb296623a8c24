"""Readings that wait are answered together: one run of the law for all of them.

A graph of many small operations costs as much to start as it costs for a reading or two. So an
estimator whose samples come faster than it answers them one by one asks its law for all that wait,
by what is known at the first of them. Each is then answered in its turn all the same: what was
asked before is only used for exactly that question.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_contact.law import LawOutput
from cablesense_contact.slides import Belief


class AskedTogether(NamedTuple):
    """What the law says of readings that came together, by one belief.

    Attributes:
        reading_n: (K, M) the readings.
        pose_rad: (2N,) where the joints are commanded.
        belief: what is known of the arm.
        torques_n2_m2: (T, T) covariance of the torques of a motion.
        seen: what the law says of each.
    """

    reading_n: Array
    pose_rad: Array
    belief: Belief
    torques_n2_m2: Array
    seen: LawOutput

    def answer(
        self, reading_n: Array, pose_rad: Array, belief: Belief, torques_n2_m2: Array
    ) -> LawOutput | None:
        """What the law says of a reading (M,); None where it was asked something else."""
        same = (
            _equal(pose_rad, self.pose_rad)
            and _equal(belief.mean, self.belief.mean)
            and _equal(belief.covariance, self.belief.covariance)
            and _equal(torques_n2_m2, self.torques_n2_m2)
        )
        rows = np.flatnonzero((self.reading_n == reading_n).all(axis=1))
        return self.seen.row(int(rows[0])) if same and len(rows) else None


def _equal(one: Array, other: Array) -> bool:
    """Whether arrays have the same numbers; that of one with itself is the usual case."""
    return one is other or np.array_equal(one, other)
