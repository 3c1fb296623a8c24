"""A block of a protocol: one thing done to the arm without a break, recorded as one trial."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class BlockKind(StrEnum):
    """What is done in a block."""

    REST = "rest"
    LOAD_CYCLE = "load cycle"
    SLACKENING = "slackening cycle"
    STEP_LOAD = "step load"
    HOLD = "hold and release"
    MOVE = "move"
    SWEEP = "pose sweep"
    REVERSALS = "small reversals"


@dataclass(frozen=True)
class Block:
    """Commands and a load on one segment over time, straight lines between knots.

    Two knots at one time are a step; what holds from then on is the second.

    Attributes:
        kind: what is done.
        does: the same for a person at the arm, in one sentence.
        knots_s: (K,) ascending from 0; the last is the block's duration.
        commands_rad: (K, 2N) commanded joint angles.
        segment: 1 to N where the load acts, 0 in a block without one.
        loads_n: (K, 3) the load, base frame.
    """

    kind: BlockKind
    does: str
    knots_s: Array
    commands_rad: Array
    segment: int
    loads_n: Array

    @property
    def duration_s(self) -> float:
        """How long it takes."""
        return float(self.knots_s[-1])

    @property
    def peak_n(self) -> float:
        """Magnitude of the strongest load."""
        return float(np.linalg.norm(self.loads_n, axis=-1).max())

    def at(self, time_s: Array) -> tuple[Array, Array]:
        """Commands (R, 2N) and loads (R, 3) at times (R,) since the block began."""
        return _between(time_s, self.knots_s, self.commands_rad), _between(
            time_s, self.knots_s, self.loads_n
        )


class ProtocolRows(NamedTuple):
    """What a recording of a protocol has beside tensions; arrays as in `Recording`."""

    time_s: Array
    trial: NDArray[np.int64]
    command_rad: Array
    load_segment: NDArray[np.int64]
    load_n: Array


def rows_of(blocks: tuple[Block, ...], rate_hz: float) -> ProtocolRows:
    """One row every 1 / `rate_hz`, block after block, each a trial of its own."""
    counts = [max(1, round(block.duration_s * rate_hz)) for block in blocks]
    sampled = [
        block.at(np.arange(count) / rate_hz) for block, count in zip(blocks, counts, strict=True)
    ]
    load_n = np.concatenate([load for _, load in sampled])
    segment = np.repeat([block.segment for block in blocks], counts)
    return ProtocolRows(
        time_s=np.arange(sum(counts)) / rate_hz,
        trial=np.repeat(np.arange(len(blocks)), counts),
        command_rad=np.concatenate([command for command, _ in sampled]),
        load_segment=np.where((load_n != 0.0).any(axis=1), segment, 0),
        load_n=load_n,
    )


def _between(time_s: Array, knots_s: Array, values: Array) -> Array:
    return np.stack([np.interp(time_s, knots_s, column) for column in values.T], axis=-1)
