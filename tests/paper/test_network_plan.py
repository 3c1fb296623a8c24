"""A plan names every shape once, and the quick one is a small part of the full one."""

import pytest
from network_findings import PLAN

from cablesense_paper.network_findings import ARCHITECTURES, FULL, QUICK


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
