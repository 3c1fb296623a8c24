"""Findings are means over the seeds and ratios over like widths."""

import pytest
from network_findings import PLAN, made_up

from cablesense_paper.network_findings import DIRECTION, FORCE, METRICS, WRONG, Shape


def test_an_error_is_the_mean_over_the_seeds():
    best = Shape("decoupled", 2, 8)
    assert made_up(1.0).errors(best, DIRECTION) == pytest.approx([1.0, 1.1])
    for metric in METRICS:
        assert made_up(1.0).mean(best, metric) == pytest.approx(1.05)


def test_the_least_network_that_reaches_the_paper_is_the_one_of_fewest_parameters():
    # 2 % wrong contacts are the strictest of the paper's figures
    assert made_up(0.01).least_that_reaches() == Shape("decoupled", 1, 4)
    assert made_up(1.0).least_that_reaches() == Shape("decoupled", 2, 8)
    assert made_up(1.95).least_that_reaches() is None


def test_architectures_are_compared_at_like_widths():
    findings = made_up(1.0)
    ratios = findings.error_ratios("shared trunk", "decoupled")
    assert ratios == pytest.approx({WRONG: 2.0, DIRECTION: 2.0, FORCE: 2.0})
    assert findings.error_ratios("two-stage", "shared trunk")[FORCE] == pytest.approx(1.5)
    assert findings.parameter_ratio("shared trunk", "decoupled") == pytest.approx(1 / 3)
    assert findings.cost_ratio("shared trunk", "decoupled") == pytest.approx(1.0)


def test_only_compared_shapes_are_timed():
    assert tuple(made_up(1.0).cost_us) == PLAN.compared
