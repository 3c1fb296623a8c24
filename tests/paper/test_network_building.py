"""Shapes are built as they are named, and counted without what states the uncertainty."""

import pytest
import torch

from cablesense_paper.network_findings import ARCHITECTURES, Shape
from cablesense_paper.network_trials import build, parameters
from cablesense_sim.arm import open_arm

ARM = open_arm("cdsm")


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
    assert parameters(build(shape, ARM, 0)) == 3 * trunk + heads


def test_a_shared_trunk_is_there_once():
    shape = Shape("shared trunk", 2, 16)
    trunk = (12 + 1) * 16 + (16 + 1) * 16
    assert parameters(build(shape, ARM, 0)) == trunk + (16 + 1) * (5 + 2 + 1)


def test_the_first_of_two_stages_has_a_layer_less():
    first = (12 + 1) * 16 + (16 + 1) * 5
    second = (12 + 5 + 1) * 16 + (16 + 1) * 16 + (16 + 1) * 3
    assert parameters(build(Shape("two-stage", 2, 16), ARM, 0)) == first + second
