"""The corrected closed form: statics until trained, bounded corrections after, finite always."""

import numpy as np
import pytest
import torch

from cablesense_sim.arm import open_arm
from cablesense_training.networks.statics import LARGEST_CORRECTION, CorrectedClosedForm

CDSM = open_arm("cdsm")


@pytest.fixture(scope="module")
def untrained():
    return CorrectedClosedForm.for_arm(CDSM).eval()


@pytest.fixture(scope="module")
def wild():
    """Weights as no training would leave them."""
    network = CorrectedClosedForm.for_arm(CDSM).eval()
    torch.manual_seed(1)
    with torch.no_grad():
        torch.nn.init.normal_(network.heads.weight, std=50.0)
    return network


def _statics(network, tension, command):
    """Candidates by statics alone."""
    with torch.no_grad():
        return network.closed_form.candidates(network.closed_form(tension, command))


def _force(output):
    return output.magnitude_n[:, None] * output.direction


@pytest.mark.parametrize("size_n", [0.0, 50.0, 1e9])
def test_corrections_stay_within_their_bound_whatever_comes_in(untrained, wild, size_n):
    generator = torch.Generator().manual_seed(2)
    tension = size_n * torch.randn(100, 12, generator=generator, dtype=torch.float64)
    command = 0.2 * torch.randn(100, 8, generator=generator, dtype=torch.float64)
    with torch.no_grad():
        plain, corrected = untrained(tension, command), wild(tension, command)
    found = _statics(wild, tension, command)
    chosen = plain.contact_logits[:, 1:].argmax(dim=1)
    rows = torch.arange(len(chosen))
    covariance = found.covariance_n2[rows, chosen]
    moved = _force(corrected) - _force(plain)
    widest = LARGEST_CORRECTION * torch.sqrt(covariance.diagonal(dim1=1, dim2=2).sum(1))
    rounding = 3e-3 + 1e-14 * _force(plain).norm(dim=1)
    assert bool((moved.norm(dim=1) <= widest * (1.0 + 1e-6) + rounding).all())
    ratio = corrected.magnitude_std_n / plain.magnitude_std_n
    assert bool(((ratio > np.exp(-1.01)) & (ratio < np.exp(1.01))).all())


@pytest.mark.parametrize(
    "tension",
    [np.zeros(12), np.full(12, -1e3), np.full(12, -1e6), 1e-12 * np.ones(12)],
    ids=["nothing", "all slack", "-1e6", "next to nothing"],
)
@pytest.mark.parametrize("arm", ["cdsm", "cdsm_lab"])
def test_absurd_readings_get_finite_answers(arm, tension):
    network = CorrectedClosedForm.for_arm(open_arm(arm)).eval()
    for command in (np.zeros(8), np.full(8, 0.3), np.full(8, -1.5)):
        with torch.no_grad():
            output = network(torch.as_tensor(tension)[None], torch.as_tensor(command)[None])
        assert all(bool(torch.isfinite(part).all()) for part in output)
        assert float(output.magnitude_std_n) > 0.0
        assert float(output.angle_std_deg) > 0.0
        probabilities = torch.softmax(output.contact_logits, dim=-1)
        torch.testing.assert_close(probabilities.sum(), torch.tensor(1.0, dtype=torch.float64))


def test_noise_alone_is_no_contact(untrained):
    rng = np.random.default_rng(3)
    noise = torch.as_tensor(rng.normal(0.0, 0.07, (500, 12)))
    command = torch.as_tensor(rng.uniform(-0.17, 0.17, (500, 8)))
    with torch.no_grad():
        logits = untrained(noise, command).contact_logits
    assert float((logits.argmax(dim=1) == 0).double().mean()) > 0.98
