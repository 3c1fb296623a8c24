"""Section III-C: networks of many shapes are built, tried, compared and drawn as planned."""

from dataclasses import replace

import matplotlib.pyplot as plt
import pytest
import torch
from paper_studies import result_of

from cablesense_gap.report.style import style
from cablesense_paper import network_trials
from cablesense_paper.network_trials import (
    ARCHITECTURES,
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
    build,
    parameter_count,
    trial,
)
from cablesense_paper.studies.networks import (
    architecture_figure,
    cost_figure,
    depth_figure,
    figures_of,
    numbers_of,
)
from cablesense_paper.study import read_study_text
from cablesense_sim.arm import open_arm
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import SingleContact
from cablesense_training.fit import FitSettings

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


@pytest.mark.parametrize("architecture", ARCHITECTURES)
@pytest.mark.parametrize("depth", [1, 3])
def test_the_same_seed_gives_the_same_network(architecture, depth):
    one, same, other = (build(Shape(architecture, depth, 8), ARM, seed) for seed in (1, 1, 2))
    x = torch.ones(2, ARM.cable_count)
    assert torch.equal(one(x).magnitude_n, same(x).magnitude_n)
    assert not torch.equal(one(x).magnitude_n, other(x).magnitude_n)


def test_three_networks_apart_have_three_trunks():
    shape = Shape("decoupled", 2, 16)
    trunk = (12 + 1) * 16 + (16 + 1) * 16
    heads = (16 + 1) * (5 + 2 + 1)
    assert parameter_count(build(shape, ARM, 0)) == 3 * trunk + heads


def test_a_shared_trunk_is_there_once():
    shape = Shape("shared trunk", 2, 16)
    trunk = (12 + 1) * 16 + (16 + 1) * 16
    assert parameter_count(build(shape, ARM, 0)) == trunk + (16 + 1) * (5 + 2 + 1)


def test_the_first_of_two_stages_has_a_layer_less():
    first = (12 + 1) * 16 + (16 + 1) * 5
    second = (12 + 5 + 1) * 16 + (16 + 1) * 16 + (16 + 1) * 3
    assert parameter_count(build(Shape("two-stage", 2, 16), ARM, 0)) == first + second


@pytest.mark.parametrize("plan", [FULL, QUICK, PLAN], ids=["full", "quick", "tiny"])
def test_every_architecture_has_every_width_at_the_compared_depth(plan):
    assert len(set(plan.shapes)) == len(plan.shapes)
    assert sorted(plan.compared) == sorted(
        (architecture, plan.compared_depth, width)
        for architecture in ARCHITECTURES
        for width in plan.widths
    )


def test_decoupled_networks_are_tried_at_every_depth():
    depths = {shape.depth for shape in FULL.shapes if shape.architecture == "decoupled"}
    assert depths == set(FULL.depths)


def test_the_quick_plan_is_a_small_part_of_the_full_one():
    assert set(QUICK.depths) < set(FULL.depths)
    assert set(QUICK.widths) < set(FULL.widths)
    assert QUICK.samples * QUICK.epochs < 0.1 * FULL.samples * FULL.epochs


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


def test_an_error_is_the_mean_over_the_seeds():
    best = Shape("decoupled", 2, 8)
    results = made_up(1.0)
    assert list(results.trials.loc[[best], DIRECTION]) == pytest.approx([1.0, 1.1])
    for metric in PAPER_ERRORS:
        assert results.means.loc[best, metric] == pytest.approx(1.05)


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


def test_only_compared_shapes_are_timed():
    assert tuple(made_up(1.0).cost_us) == PLAN.compared


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


def test_progress_only_grows(explored):
    _, _, shares = explored
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(0.99)


@pytest.fixture
def drawn():
    """Draws a figure of made-up results."""

    def figure_of(draw):
        with style():
            return draw(made_up(1.0))

    yield figure_of
    plt.close("all")


def _names(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


@pytest.mark.parametrize("draw", [architecture_figure, cost_figure])
def test_every_architecture_is_in_the_legend_once(draw, drawn):
    assert _names(drawn(draw)) == list(ARCHITECTURES)


def test_every_depth_is_in_the_legend_beside_the_papers(drawn):
    assert _names(drawn(depth_figure)) == ["1 layer", "2 layers", "the paper’s network"]


def test_the_line_is_the_mean_of_the_seeds_which_are_its_dots(drawn):
    direction = drawn(depth_figure).axes[1]
    paper, line, *dots = direction.lines[:6]
    assert set(paper.get_ydata()) == {5.96}
    assert list(line.get_xdata()) == [4, 8]
    assert list(line.get_ydata()) == pytest.approx([4.2, 2.1])
    assert [tuple(dot.get_xydata()[0]) for dot in dots] == [
        pytest.approx(at) for at in ((4, 4.0), (4, 4.4), (8, 2.0), (8, 2.2))
    ]


def stated(results):
    return result_of("networks", lambda _: (numbers_of(results), figures_of(results)))


@pytest.fixture(scope="module")
def poor():
    return stated(made_up(50.0))


@pytest.fixture(scope="module")
def good():
    return stated(made_up(1.0))


def test_every_shape_has_a_row(good):
    assert [row[:3] for row in good.tables[0].rows] == list(PLAN.shapes)
    timed = [row for row in good.tables[0].rows if row[-1] != "–"]
    assert {row[1] for row in timed} == {PLAN.compared_depth}


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
