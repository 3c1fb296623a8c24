"""Contacts anywhere: known ones explain the torques, and what is left is calibrated."""

import pytest
from arm_variants import variant
from scipy.stats import chi2

from cablesense_sim.arm import open_arm
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import AnywhereContact
from cablesense_training.errors import TrainingError
from cablesense_training.evaluation.anywhere import evaluate_anywhere
from cablesense_training.fit import fit_anywhere, misfits
from cablesense_training.inference.anywhere import AnywhereEstimator
from cablesense_training.inference.metadata import find_model
from cablesense_training.model_training import build_network


def drawn(arm, **options):
    return draw_dataset(arm, AnywhereContact(samples=2000, pose="random", **options), seed=3)


@pytest.mark.parametrize(("name", "largest_n"), [("cdsm", 200.0), ("cdsm_lab", 190.0)])
def test_without_noise_the_known_contacts_explain_all_torques(name, largest_n):
    arm = open_arm(name)
    data = drawn(arm, noise=False, force_high_n=largest_n)
    left = misfits(build_network("anywhere", arm), data)
    assert len(left) > 0.98 * len(data)
    assert left.max() < 0.5


@pytest.mark.parametrize("noise_std_n", [None, 0.2], ids=["as stated", "more than stated"])
def test_what_is_stated_holds_on_fresh_samples(noise_std_n):
    arm = open_arm("cdsm")
    noisy = arm if noise_std_n is None else variant({"sensors.noise_std_n": noise_std_n}, "cdsm")
    network = build_network("anywhere", arm)
    fit_anywhere(network, drawn(noisy))
    assert (network.spread.factor > 1.1).all() == (noise_std_n is not None)
    fresh = draw_dataset(noisy, AnywhereContact(samples=2000, pose="random"), seed=4)
    within = (misfits(network, fresh) < chi2.ppf(0.95, 8)).double()
    assert within.mean() == pytest.approx(0.95, abs=0.02)


def test_refuses_samples_that_show_no_torques():
    arm = open_arm("cdsm")
    with pytest.raises(TrainingError, match="too few to train on"):
        fit_anywhere(build_network("anywhere", arm), drawn(arm).select(slice(0, 9)))


def test_contacts_are_located_as_well_as_tensions_permit():
    arm = open_arm("cdsm_lab")
    protocol = AnywhereContact(samples=600, pose="random", force_high_n=50.0)
    estimator = AnywhereEstimator.load(find_model("cdsm_lab_anywhere"), arm)
    plain = evaluate_anywhere(estimator, draw_dataset(arm, protocol, seed=5)).as_json()
    assert plain["false_contacts"] == 0
    for segment in ("segment_2", "segment_3", "segment_4"):
        assert plain["shares"][segment]["segment_right"] > 0.98
        assert 0.8 < plain["place_mm"][segment]["rms_over_bound"] < 1.2
        assert 0.9 < plain["shares"][segment]["place_coverage95"] <= 1.0
    assert set(plain["place_mm"]) == {*(f"segment_{n}" for n in (1, 2, 3, 4)), "pairs"}
    assert plain["shares"]["segment_1"]["clear_segment_right"] is None
