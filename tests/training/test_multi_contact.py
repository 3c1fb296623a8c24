"""Several contacts at once, by networks and by model files."""

import numpy as np
import pytest
import torch

from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import MultiContact
from cablesense_training.errors import ModelFileError
from cablesense_training.inference.estimator import MultiEstimator
from cablesense_training.inference.metadata import find_model
from cablesense_training.networks.statics import MultiContactClosedForm

pytestmark = pytest.mark.slow


ARMS = ("cdsm", "cdsm_lab", "cdsm_table2")
BARELY_TAUT_N = 0.6
"""Tensions below this may pass for none."""


def _network(name):
    return MultiContactClosedForm.for_arm(open_arm(name)).eval()


def _answers(network, tension_difference_n, command_rad):
    with torch.no_grad():
        said = network(
            torch.as_tensor(np.ascontiguousarray(tension_difference_n)),
            torch.as_tensor(np.ascontiguousarray(command_rad)),
        )
    return type(said)(*(part.numpy() for part in said))


def _pushed(mechanism, command, touched, rng, high_n):
    """Noise-free differences, magnitudes (B, N), and the rows whose taut cables tell the pose."""
    rows, n = touched.shape
    magnitude = np.where(touched, rng.uniform(5.0, high_n, (rows, n)), 0.0)
    forces = sum(
        normal_force_n(
            mechanism,
            command,
            np.full(rows, segment + 1),
            rng.uniform(0.0, 360.0, rows),
            magnitude[:, segment],
        )
        for segment in range(n)
    )
    loaded = solve_equilibrium(mechanism, command, forces).tensions_n
    told = (loaded == 0.0).sum(axis=1) <= mechanism.cable_count - mechanism.joint_count
    told &= ~((loaded > 0.0) & (loaded < BARELY_TAUT_N)).any(axis=1)
    return loaded - solve_equilibrium(mechanism, command).tensions_n, magnitude, told


@pytest.mark.parametrize("arm", ARMS)
def test_without_noise_every_touched_segment_and_its_force_are_recovered(arm):
    mechanism = mechanism_of(open_arm(arm))
    rng = np.random.default_rng(0)
    command = rng.uniform(-0.17, 0.17, (400, mechanism.joint_count))
    touched = rng.random((400, mechanism.segment_count)) < 0.5
    difference, magnitude, told = _pushed(mechanism, command, touched, rng, 40.0)
    assert told.sum() > 250
    assert touched[told].sum(axis=1).max() == mechanism.segment_count
    said = _answers(_network(arm), difference, command)
    found = said.contact_logits > 0.0
    np.testing.assert_array_equal(found[told], touched[told])
    error = np.abs(said.magnitude_n - magnitude)[told]
    assert np.median(error[touched[told]]) < 0.002
    assert error.max() < 0.1
    assert error[~touched[told]].max() < 0.002


@pytest.fixture(scope="module", params=ARMS)
def noisy(request):
    """Samples with sensor noise at random poses, and what statics says of them."""
    protocol = MultiContact(samples=1000, pose="random", pose_range_deg=10.0)
    dataset = draw_dataset(open_arm(request.param), protocol, seed=1)
    network = _network(request.param)
    return dataset, _answers(network, dataset.tension_difference_n, dataset.command_rad)


def test_under_noise_contacts_of_some_newtons_are_recognised(noisy):
    dataset, said = noisy
    found = said.contact_logits > 0.0
    firm = ((dataset.magnitudes_n > 2.0) | ~dataset.contacts).all(axis=1)
    for count in range(dataset.arm.segment_count + 1):
        rows = firm & (dataset.contacts.sum(axis=1) == count)
        assert (found == dataset.contacts)[rows].all(axis=1).mean() > 0.97, count
    assert (found & ~dataset.contacts).mean() < 0.005


def test_stated_deviations_are_those_of_the_errors(noisy):
    dataset, said = noisy
    found = (said.contact_logits > 0.0) & dataset.contacts
    off = np.abs(said.magnitude_n - dataset.magnitudes_n)[found] / said.magnitude_std_n[found]
    assert 0.9 < (off < 1.96).mean() < 0.99
    assert (said.magnitude_std_n > 0.0).all()


@pytest.mark.parametrize("size_n", [0.0, -1e3, 1e6, -1e6])
def test_absurd_readings_get_finite_answers(size_n):
    command = np.stack([np.zeros(8), np.full(8, 0.3), np.full(8, -1.5)])
    said = _answers(_network("cdsm"), np.full((3, 12), size_n), command)
    assert all(np.isfinite(part).all() for part in said)
    if not size_n:
        assert (said.contact_logits[:2] < 0.0).all()


CDSM = open_arm("cdsm")


def test_a_model_of_one_contact_or_another_arm_is_refused():
    with pytest.raises(ModelFileError, match="single-contact"):
        MultiEstimator.load(find_model("cdsm"))
    with pytest.raises(ModelFileError, match="cdsm_lab"):
        MultiEstimator.load(find_model("cdsm_multi"), open_arm("cdsm_lab"))
