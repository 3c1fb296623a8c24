"""Which shapes of networks are tried, on how much, and what the trials say together."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from cablesense_paper.network_trials import Trial
    from cablesense_training.data.protocols import Pose

DECOUPLED, SHARED_TRUNK, TWO_STAGE = "decoupled", "shared trunk", "two-stage"


ARCHITECTURES = (DECOUPLED, SHARED_TRUNK, TWO_STAGE)
"""By the paper: three networks apart, one trunk for all, contact first and force given it."""


class Shape(NamedTuple):
    """A network: its architecture, and how deep and wide each of its trunks is.

    The first stage of two has a layer less than the second.
    """

    architecture: str
    depth: int
    width: int


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


WRONG, DIRECTION, FORCE = "wrong, %", "direction MAE, °", "force MAE, N"


METRICS: dict[str, Callable[[Trial], float]] = {
    WRONG: lambda trial: 100.0 * trial.wrong_contact,
    DIRECTION: lambda trial: trial.direction_mae_deg,
    FORCE: lambda trial: trial.magnitude_mae_n,
}
"""Errors of a trial, by the names that tables and axes give them."""


PAPER_FIGURES = {WRONG: 2.0, DIRECTION: 5.96, FORCE: 9.97}
"""The paper's figures of its single-contact network."""


@dataclass(frozen=True)
class Findings:
    """Of one plan.

    Attributes:
        plan: what was tried.
        trials: of every shape and seed of the plan.
        cost_us: microseconds of one answer of the compared shapes.
        with_little_data: by pose, the network that learnt from the paper's amount of data.
    """

    plan: Plan
    trials: tuple[Trial, ...]
    cost_us: Mapping[Shape, float]
    with_little_data: Mapping[Pose, Trial]

    def errors(self, shape: Shape, metric: str) -> list[float]:
        """One of `METRICS` for every seed of a shape."""
        return [METRICS[metric](one) for one in self.trials if one.shape == shape]

    def mean(self, shape: Shape, metric: str) -> float:
        """One of `METRICS`, mean over the seeds."""
        return float(np.mean(self.errors(shape, metric)))

    def parameters(self, shape: Shape) -> int:
        """Trained numbers behind the answers of a shape."""
        return next(one.parameters for one in self.trials if one.shape == shape)

    def least_that_reaches(self) -> Shape | None:
        """The decoupled shape of fewest parameters that is as good as the paper in all."""
        reached = [
            shape
            for shape in self.plan.shapes
            if shape.architecture == DECOUPLED
            and all(self.mean(shape, metric) <= most for metric, most in PAPER_FIGURES.items())
        ]
        return min(reached, key=self.parameters, default=None)

    def error_ratios(self, ours: str, theirs: str) -> dict[str, float]:
        """Errors of one architecture over those of another, by metric.

        Geometric means over the widths, at the compared depth.
        """
        pairs = self._pairs(ours, theirs)
        return {
            metric: _geometric_mean(self.mean(a, metric) / self.mean(b, metric) for a, b in pairs)
            for metric in METRICS
        }

    def parameter_ratio(self, ours: str, theirs: str) -> float:
        """Parameters of one architecture over those of another, likewise."""
        pairs = self._pairs(ours, theirs)
        return _geometric_mean(self.parameters(a) / self.parameters(b) for a, b in pairs)

    def cost_ratio(self, ours: str, theirs: str) -> float:
        """Time that answers of one architecture take over that of another, all widths together."""
        one, other = (
            np.mean([us for shape, us in self.cost_us.items() if shape.architecture == name])
            for name in (ours, theirs)
        )
        return float(one / other)

    def _pairs(self, ours: str, theirs: str) -> list[tuple[Shape, Shape]]:
        """Compared shapes of two architectures, by width."""
        return [
            (a, b)
            for a in self.plan.compared
            for b in self.plan.compared
            if (a.architecture, b.architecture) == (ours, theirs) and a.width == b.width
        ]


def _geometric_mean(ratios: Iterable[float]) -> float:
    return float(np.exp(np.mean(np.log(list(ratios)))))
