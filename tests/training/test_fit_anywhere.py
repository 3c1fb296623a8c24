"""Training on contacts anywhere: they explain the torques, and what is left is calibrated."""

import numpy as np
import pytest
import torch
from arm_variants import variant
from scipy.stats import chi2

from cablesense_sim.arm import open_arm
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import AnywhereContact
from cablesense_training.errors import TrainingError
from cablesense_training.fit import FitSettings
from cablesense_training.fit_anywhere import fit_anywhere, known_torques, torques_by_contacts
from cablesense_training.inference.anywhere import AnywhereEstimator
from cablesense_training.model_training import draw_training_data, train_model
from cablesense_training.recipes import build_network

QUICK = FitSettings(epochs=2, batch_size=256, threads=1)


def drawn(arm, **options):
    return draw_dataset(arm, AnywhereContact(samples=2000, pose="random", **options), seed=3)


def misfits(network, data):
    """chi² (B,) of what the true contacts leave of the graph's torques."""
    given = data.tension_difference_n, data.command_rad, data.local_forces_n, data.places_m
    difference, command, force, place = map(torch.as_tensor, given)
    with torch.no_grad():
        balance = network(difference, command)
    left = balance.torque_n_m - torques_by_contacts(balance, force, place)
    return torch.einsum("bi,bij,bj->b", left, balance.precision, left).numpy()


@pytest.mark.parametrize(("name", "largest_n"), [("cdsm", 200.0), ("cdsm_lab", 190.0)])
def test_without_noise_the_known_contacts_explain_all_torques(name, largest_n):
    arm = open_arm(name)
    data = drawn(arm, noise=False, force_high_n=largest_n)
    left = known_torques(build_network("anywhere", arm), data)
    assert len(left.taut) > 0.98 * len(data)
    chi_square = torch.einsum("bi,bij,bj->b", left.torque_n_m, left.precision, left.torque_n_m)
    assert chi_square.max() < 0.5


def test_what_noise_alone_makes_is_not_learnt_and_calibration_holds_on_fresh_samples():
    arm = open_arm("cdsm")
    network = build_network("anywhere", arm)
    fit_anywhere(network, drawn(arm), QUICK)
    assert not network.heads.weight.any()
    fresh = draw_dataset(arm, AnywhereContact(samples=2000, pose="random"), seed=4)
    within = misfits(network, fresh) < chi2.ppf(0.95, 8)
    assert within.mean() == pytest.approx(0.95, abs=0.02)


def test_noise_that_the_arm_file_does_not_state_widens_what_is_stated():
    arm = open_arm("cdsm")
    noisier = drawn(variant({"sensors.noise_std_n": 0.2}, "cdsm"))
    network = build_network("anywhere", arm)
    fit_anywhere(network, noisier, FitSettings(epochs=10, batch_size=64, threads=1))
    assert np.quantile(misfits(network, noisier), 0.95) == pytest.approx(
        chi2.ppf(0.95, 8), rel=0.1
    )


def test_refuses_samples_that_show_no_torques():
    arm = open_arm("cdsm")
    with pytest.raises(TrainingError, match="too few to train on"):
        fit_anywhere(build_network("anywhere", arm), drawn(arm).select(slice(0, 9)), QUICK)


@pytest.mark.slow
def test_the_model_file_locates_contacts_as_the_report_says(tmp_path):
    arm, path = open_arm("cdsm_lab"), tmp_path / "model.onnx"
    options = {"samples": 1500, "pose": "random", "pose_range_deg": 10.0, "force_high_n": 50.0}
    data = draw_training_data(arm, "anywhere", options, seed=0)
    report = train_model(path, "anywhere", data, QUICK, command="so", test_samples=600)
    assert AnywhereEstimator.load(path, arm).metadata.force_range_n == 50.0
    assert report.anywhere is not None
    assert report.anywhere.false_contacts == 0
    for errors in report.anywhere.segments[1:]:
        assert errors.segment_right > 0.98
        assert 0.8 < errors.place_mm.rms_over_bound < 1.2
        assert 0.9 < errors.place_coverage95 <= 1.0
    plain = report.as_json()["anywhere"]
    assert set(plain["place_mm"]) == {*(f"segment_{n}" for n in (1, 2, 3, 4)), "pairs"}
    assert plain["shares"]["segment_1"]["clear_segment_right"] is None
