"""Section III-C: networks of many shapes are tried, compared and drawn as planned."""

from dataclasses import replace

import pytest
from paper_studies import result_of

from cablesense_sim.arm import open_arm
from examples.paper.studies import networks
from examples.paper.studies.networks import (
    FORCE_RMSE,
    PAPER_ERRORS,
    PARAMETERS,
    Plan,
    Shape,
    TrialResults,
    figures_of,
    numbers_of,
)

pytestmark = pytest.mark.slow


ARM = open_arm("cdsm")


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


def made_up(least_error):
    """Results whose smallest error, of any kind, is `least_error`.

    Errors shrink with width and depth alike. The second seed is a tenth worse than the first.
    """
    largest = max(shape.depth * shape.width for shape in PLAN.shapes)
    trials = [
        _trial(shape, seed, (1.0 + 0.1 * seed) * least_error * largest)
        for shape in PLAN.shapes
        for seed in PLAN.seeds
    ]
    one_layer_of_one = Shape("decoupled", 1, 1)
    little = _trial(one_layer_of_one, 0, least_error)
    return TrialResults(PLAN, trials, dict.fromkeys(PLAN.paper_poses, little))


def _trial(shape, seed, error_of_one):
    """A trial of a shape, from the error that one decoupled layer of one would make."""
    size = shape.depth * shape.width
    error = WORSE[shape.architecture] * error_of_one / size
    return {
        **shape._asdict(),
        "seed": seed,
        PARAMETERS: (3 if shape.architecture == "decoupled" else 1) * 100 * size,
        **dict.fromkeys(PAPER_ERRORS, error),
        FORCE_RMSE: 1.5 * error,
    }


def test_the_least_network_that_reaches_the_paper_is_the_one_of_fewest_parameters():
    # 2 % wrong contacts are the strictest of the paper's figures
    assert made_up(0.01).smallest_like_the_paper() == Shape("decoupled", 1, 4)
    assert made_up(1.0).smallest_like_the_paper() == Shape("decoupled", 2, 8)
    assert made_up(1.95).smallest_like_the_paper() is None


def test_every_shape_is_tried_with_every_seed_and_one_learns_from_little_data(monkeypatch):
    monkeypatch.setattr(networks, "PAPER_SAMPLES", 128)
    plan, shares = replace(PLAN, seeds=(0, 3), samples=128, test_samples=64), []
    results = networks.explore(plan, shares.append)
    tried = [*zip(results.trials.index, results.trials["seed"], strict=True)]
    assert tried == [(shape, seed) for shape in plan.shapes for seed in plan.seeds]
    assert shares == sorted(shares)
    assert tuple(results.with_little_data) == plan.paper_poses
    for one in results.with_little_data.values():
        assert one.items() >= networks.PAPER_SHAPE._asdict().items()


def stated(results):
    return result_of("networks", lambda _: (numbers_of(results), figures_of(results)))


@pytest.fixture(scope="module")
def good():
    return stated(made_up(1.0))


def test_the_smallest_networks_that_are_as_good_as_the_papers_are_named(good):
    assert "have 2 layers of 8 each, 4,800 parameters in all." in good.lead
    assert all(architecture in good.lead for architecture in WORSE)


def test_architectures_agree_with_the_paper_where_their_errors_do(good):
    apart, together, stages, *little = good.comparisons
    assert [c.agreement for c in (apart, together, stages)] == ["yes", "yes", "no"]
    assert apart.ours == "×0.50 wrong contacts, ×0.50 direction, ×0.50 force"
    assert together.ours.startswith("33% of the parameters; ×2.00")
    assert [c.agreement for c in little] == ["yes"] * 4
