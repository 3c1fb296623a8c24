"""Which shapes are tried, and on how much."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cablesense_paper.networks.shapes import ARCHITECTURES, DECOUPLED, TWO_STAGE, Shape

if TYPE_CHECKING:
    from cablesense_training.data.protocols import Pose


@dataclass(frozen=True)
class Plan:
    """How much is tried.

    Attributes:
        depths, widths: of the decoupled networks, each with each.
        compared_depth: at which the three architectures are compared, over all widths.
        seeds: each shape is trained with all of them.
        samples, batch_size, epochs: of every training.
        test_samples: that all are tested on.
        paper_poses: at which a network also learns from the paper's amount of data.
        workers: processes that train.
    """

    depths: tuple[int, ...]
    widths: tuple[int, ...]
    compared_depth: int
    seeds: tuple[int, ...]
    samples: int
    batch_size: int
    epochs: int
    test_samples: int
    paper_poses: tuple[Pose, ...]
    workers: int

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """All that are tried: decoupled networks first, each once."""
        grid = [Shape(DECOUPLED, depth, width) for depth in self.depths for width in self.widths]
        others = [
            Shape(architecture, self.compared_depth, width)
            for architecture in ARCHITECTURES
            if architecture != DECOUPLED
            for width in self.widths
        ]
        return (*grid, *others)

    @property
    def compared(self) -> tuple[Shape, ...]:
        """Those of all architectures that have the compared depth."""
        return tuple(shape for shape in self.shapes if shape.depth == self.compared_depth)


FULL = Plan(
    depths=(1, 2, 3, 4),
    widths=(16, 32, 64, 128),
    compared_depth=3,
    seeds=(0, 1),
    samples=20_480,
    batch_size=256,
    epochs=40,
    test_samples=10_240,
    paper_poses=("straight", "random"),
    workers=min(2, os.cpu_count() or 1),
)
QUICK = Plan(
    depths=(1, 2),
    widths=(32,),
    compared_depth=2,
    seeds=(0,),
    samples=4_096,
    batch_size=64,
    epochs=12,
    test_samples=2_048,
    paper_poses=("straight",),
    workers=1,
)

PAPER_SHAPE = Shape(TWO_STAGE, 3, 128)
PAPER_SAMPLES, PAPER_BATCH_SIZE = 5_000, 64
"""The two-stage network that learns from the paper's amount of data, and that amount."""
