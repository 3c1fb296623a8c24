"""The script of a headless demo: which pushes, at which poses, and when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_msgs_py.errors import CableSenseError

PUSH_S = 3.0
"""How long each push is held; the pause before it is as long as what is left of its share."""
SHORTEST_SLOT_S = 4.0
MOVE_S = 3.0
"""What a move of the joints and the arm's coming to rest may take."""
WEAKEST_N, STRONGEST_N = 5.0, 120.0
POSE_LIMIT_DEG = 8.0


class ScriptError(CableSenseError):
    """A demo of a length that holds no push."""


@dataclass(frozen=True)
class ScriptedPush:
    """One push of the script.

    Attributes:
        start_s, end_s: since the start of the script.
        segment: 1 … N.
        angle_deg: from the segment's +z towards its +y, at the commanded pose.
        magnitude_n: newtons.
        command_rad: (2N,) joint angles commanded at `move_s`, before the push.
        move_s: since the start of the script.
    """

    start_s: float
    end_s: float
    segment: int
    angle_deg: float
    magnitude_n: float
    command_rad: NDArray[np.float64]
    move_s: float


def make_script(segment_count: int, duration_s: float, seed: int) -> list[ScriptedPush]:
    """Pushes on one segment after another: at the straight arm first, then at random poses.

    Raises:
        ScriptError: the duration is too short for one push.
    """
    if not duration_s >= SHORTEST_SLOT_S:
        raise ScriptError(
            f"duration is {duration_s:g} s; one push takes {SHORTEST_SLOT_S:g} s at least"
        )
    rng = np.random.default_rng(seed)
    straight_count = max(1, int(0.5 * duration_s / SHORTEST_SLOT_S))
    posed_count = int((duration_s - straight_count * SHORTEST_SLOT_S) / (SHORTEST_SLOT_S + MOVE_S))
    script = []
    now_s = 0.0
    for number in range(straight_count + posed_count):
        posed = number >= straight_count
        command = np.zeros(2 * segment_count)
        slot_s = SHORTEST_SLOT_S
        if posed:
            command = np.deg2rad(rng.uniform(-POSE_LIMIT_DEG, POSE_LIMIT_DEG, 2 * segment_count))
            slot_s += MOVE_S
        magnitude = WEAKEST_N * (STRONGEST_N / WEAKEST_N) ** rng.random()
        script.append(
            ScriptedPush(
                start_s=now_s + slot_s - PUSH_S,
                end_s=now_s + slot_s,
                segment=1 + number % segment_count,
                angle_deg=float(rng.uniform(0.0, 360.0)),
                magnitude_n=float(round(magnitude, 1)),
                command_rad=command,
                move_s=now_s,
            )
        )
        now_s += slot_s
    return script
