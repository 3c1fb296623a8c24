"""Section III-C: networks of many shapes are built, tried, compared and drawn as planned."""

from dataclasses import replace

import pytest
from paper_studies import result_of

from cablesense_sim.arm import open_arm
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import SingleContact
from cablesense_training.fit import FitSettings
from examples.paper import network_trials
from examples.paper.network_trials import (
    DIRECTION,
    FORCE,
    FORCE_RMSE,
    PAPER_ERRORS,
    PARAMETERS,
    WRONG,
    Plan,
    Shape,
    TrialResults,
    answer_us,
    trial,
)
from examples.paper.studies.networks import (
    figures_of,
    numbers_of,
)
from examples.paper.study import read_study_text

pytestmark = pytest.mark.slow


ARM = open_arm("cdsm")
FULL, QUICK = (Plan(**read_study_text("networks")["sizes"][mode]) for mode in ("full", "quick"))


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
    cost_us = {shape: 20.0 + shape.width for shape in PLAN.compared}
    one_layer_of_one = Shape("decoupled", 1, 1)
    little = _trial(one_layer_of_one, 0, least_error)
    return TrialResults(PLAN, trials, cost_us, dict.fromkeys(PLAN.paper_poses, little))


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


def test_a_seed_gives_the_same_metrics():
    samples = [draw_dataset(ARM, SingleContact(samples=64), seed) for seed in (0, 1)]
    settings = FitSettings(epochs=1, batch_size=64)
    one, same, other = (
        trial(*samples, settings, Shape("shared trunk", 1, 4), seed) for seed in (0, 0, 1)
    )
    assert one == same
    assert one[FORCE] != other[FORCE]


def test_an_untrained_network_is_timed_in_onnx_runtime(monkeypatch):
    monkeypatch.setattr(network_trials, "_BLOCKS", 1)
    monkeypatch.setattr(network_trials, "_RUNS", 1)
    assert answer_us(Shape("two-stage", 1, 8), ARM) > 0.0


def test_the_least_network_that_reaches_the_paper_is_the_one_of_fewest_parameters():
    # 2 % wrong contacts are the strictest of the paper's figures
    assert made_up(0.01).smallest_like_the_paper() == Shape("decoupled", 1, 4)
    assert made_up(1.0).smallest_like_the_paper() == Shape("decoupled", 2, 8)
    assert made_up(1.95).smallest_like_the_paper() is None


def test_architectures_are_compared_at_like_widths():
    results = made_up(1.0)
    ratios = results.ratios("shared trunk", "decoupled")
    errors = dict.fromkeys((WRONG, DIRECTION, FORCE, FORCE_RMSE), 2.0)
    assert ratios == pytest.approx({PARAMETERS: 1 / 3, **errors})
    assert results.ratios("two-stage", "shared trunk")[FORCE] == pytest.approx(1.5)
    assert results.cost_ratio("shared trunk", "decoupled") == pytest.approx(1.0)


@pytest.fixture(scope="module")
def explored():
    shares = []
    plan = replace(PLAN, seeds=(0, 3), samples=128, test_samples=64)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(network_trials, "answer_us", lambda shape, arm: 20.0 + shape.width)
        patch.setattr(network_trials, "PAPER_SAMPLES", 128)
        return plan, network_trials.explore(plan, shares.append), shares


def test_every_shape_is_tried_with_every_seed(explored):
    plan, results, _ = explored
    tried = [*zip(results.trials.index, results.trials["seed"], strict=True)]
    assert tried == [(shape, seed) for shape in plan.shapes for seed in plan.seeds]


def test_compared_shapes_are_timed_and_a_network_learns_from_little_data_at_every_pose(explored):
    plan, results, _ = explored
    assert tuple(results.cost_us) == plan.compared
    assert tuple(results.with_little_data) == plan.paper_poses
    for one in results.with_little_data.values():
        assert one.items() >= network_trials.PAPER_SHAPE._asdict().items()


def stated(results):
    return result_of("networks", lambda _: (numbers_of(results), figures_of(results)))


@pytest.fixture(scope="module")
def poor():
    return stated(made_up(50.0))


@pytest.fixture(scope="module")
def good():
    return stated(made_up(1.0))


def test_networks_that_learnt_next_to_nothing_are_called_so(poor):
    assert poor.lead.startswith("No decoupled network tried here")
    forces = [c for c in poor.comparisons if c.what.endswith("force error")]
    assert [c.agreement for c in forces] == ["no", "no"]


def test_the_smallest_networks_that_are_as_good_as_the_papers_are_named(good):
    assert "have 2 layers of 8 each, 4,800 parameters in all." in good.lead
    assert all(architecture in good.lead for architecture in WORSE)


def test_architectures_agree_with_the_paper_where_their_errors_do(good):
    apart, together, stages, *little = good.comparisons
    assert [c.agreement for c in (apart, together, stages)] == ["yes", "yes", "no"]
    assert apart.ours == "×0.50 wrong contacts, ×0.50 direction, ×0.50 force"
    assert together.ours.startswith("33% of the parameters, 100% of the time; ×2.00")
    assert [c.agreement for c in little] == ["yes"] * 4


def test_the_papers_errors_close_the_table_of_its_amount_of_data(good):
    assert good.tables[1].rows[-1] == ("the paper", "over 98", 5.96, 9.97, 14.26)
    assert len(good.tables[1].rows) == 1 + len(PLAN.paper_poses)
