"""What trials of many shapes say together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cablesense_paper.networks.plan import Plan
from cablesense_paper.networks.shapes import DECOUPLED, Shape

if TYPE_CHECKING:
    from cablesense_paper.networks.trials import Trial
    from cablesense_training.data.protocols import Pose

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
