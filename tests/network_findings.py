"""Findings on networks that nobody trained: figures by rule, for tests of what is made of them."""

from __future__ import annotations

from cablesense_paper.network_findings import Findings, Plan, Shape
from cablesense_paper.network_trials import Trial

PLAN = Plan(
    depths=(1, 2),
    widths=(4, 8),
    compared_depth=2,
    seeds=(0, 1),
    samples=256,
    batch_size=64,
    epochs=1,
    test_samples=256,
    paper_poses=("straight", "random"),
    workers=1,
)
WORSE = {"decoupled": 1.0, "shared trunk": 2.0, "two-stage": 3.0}
"""Errors of an architecture over those of the decoupled one."""


def made_up(least_error: float) -> Findings:
    """Findings whose smallest error, of any kind, is `least_error`.

    Errors shrink with width and depth alike. The second seed is a tenth worse than the first.
    """
    largest = max(shape.depth * shape.width for shape in PLAN.shapes)
    trials = tuple(
        _trial(shape, seed, (1.0 + 0.1 * seed) * least_error * largest)
        for shape in PLAN.shapes
        for seed in PLAN.seeds
    )
    cost_us = {shape: 20.0 + shape.width for shape in PLAN.compared}
    one_layer_of_one = Shape("decoupled", 1, 1)
    little = _trial(one_layer_of_one, 0, least_error)
    return Findings(PLAN, trials, cost_us, dict.fromkeys(PLAN.paper_poses, little))


def _trial(shape: Shape, seed: int, error_of_one: float) -> Trial:
    """A trial of a shape, from the error that one decoupled layer of one would make."""
    size = shape.depth * shape.width
    error = WORSE[shape.architecture] * error_of_one / size
    return Trial(
        shape=shape,
        seed=seed,
        parameters=(3 if shape.architecture == "decoupled" else 1) * 100 * size,
        wrong_contact=0.01 * error,
        direction_mae_deg=error,
        magnitude_mae_n=error,
        magnitude_rmse_n=1.5 * error,
    )
