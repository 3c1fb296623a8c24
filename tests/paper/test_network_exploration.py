"""A plan is carried out whole: every shape and seed, in the plan's order."""

from dataclasses import replace

import pytest
from network_findings import PLAN

from cablesense_paper import network_trials

pytestmark = pytest.mark.slow  # trains


@pytest.fixture(scope="module")
def explored():
    told = []
    plan = replace(PLAN, seeds=(0, 3), samples=128, test_samples=64)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(network_trials, "answer_us", lambda shape, arm: 20.0 + shape.width)
        patch.setattr(network_trials, "PAPER_SAMPLES", 128)
        return plan, network_trials.explore(plan, told.append), told


def test_every_shape_is_tried_with_every_seed(explored):
    plan, findings, _ = explored
    tried = [(one.shape, one.seed) for one in findings.trials]
    assert tried == [(shape, seed) for shape in plan.shapes for seed in plan.seeds]


def test_compared_shapes_are_timed_and_a_network_learns_from_little_data_at_every_pose(explored):
    plan, findings, _ = explored
    assert tuple(findings.cost_us) == plan.compared
    assert tuple(findings.with_little_data) == plan.paper_poses
    assert {one.shape for one in findings.with_little_data.values()} == {
        network_trials.PAPER_SHAPE
    }


def test_progress_only_grows(explored):
    _, _, told = explored
    assert told == sorted(told)
    assert told[-1] == pytest.approx(0.99)
