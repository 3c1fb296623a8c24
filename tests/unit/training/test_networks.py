"""Rules that all networks keep, layers that they share, and the paper's two-stage network."""

import pytest
import torch

from cablesense_base.installation import config_path
from cablesense_sim.arm import load_arm
from cablesense_training.model_training import RECIPES, build_network

ARM = load_arm(config_path("arms/cdsm.yaml"))


def _inputs(rows):
    generator = torch.Generator().manual_seed(1)
    tension = 40.0 * torch.randn(rows, 12, generator=generator)
    return tension, 0.1 * torch.randn(rows, 8, generator=generator)


@pytest.mark.slow
@pytest.mark.parametrize("name", RECIPES)
def test_answers_have_the_contract_shapes_and_positive_deviations(name):
    network = build_network(name, ARM)
    output = network(*_inputs(7))
    if network.several:
        assert [tuple(part.shape) for part in output] == [(7, 4)] * 3
    else:
        assert [tuple(part.shape) for part in output] == [(7, 5), (7, 2), (7,), (7,), (7,)]
        assert bool((output.angle_std_deg > 0).all())
    assert bool((output.magnitude_std_n > 0).all())
    assert all(bool(torch.isfinite(part).all()) for part in output)


@pytest.mark.slow
@pytest.mark.parametrize("name", RECIPES)
def test_rows_do_not_influence_each_other(name):
    network = build_network(name, ARM).double().eval()
    tension, command = (part.double() for part in _inputs(6))
    whole = network(tension, command)
    single = network(tension[2:3], command[2:3])
    for all_rows, row in zip(whole, single, strict=True):
        torch.testing.assert_close(all_rows[2:3], row, atol=1e-9, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", RECIPES)
def test_the_seed_fixes_the_initial_weights_and_nothing_else(name):
    torch.manual_seed(5)
    expected_draw = torch.rand(3)
    torch.manual_seed(5)
    first = build_network(name, ARM, seed=3)
    second = build_network(name, ARM, seed=3)
    torch.testing.assert_close(torch.rand(3), expected_draw, atol=0.0, rtol=0.0)
    other = build_network(name, ARM, seed=4)
    weights = [network.state_dict() for network in (first, second, other)]
    assert all(torch.equal(weights[0][key], weights[1][key]) for key in weights[0])
    assert not all(torch.equal(weights[0][key], weights[2][key]) for key in weights[0])
