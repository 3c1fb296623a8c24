"""The graph of contacts anywhere: agrees with the law in NumPy, and shows what does not fit."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.contact_location import torque_balance
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.replay import difference_variance_n2
from cablesense_training.inference.anywhere import AnywhereEstimator
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model
from cablesense_training.networks.statics import AnywhereStatics

TARE_SAMPLES = 50
LARGEST_N = {"cdsm": 150.0, "cdsm_lab": 40.0}


class Pushed:
    """Samples of an arm in random poses, without noise, with one contact each."""

    def __init__(self, name, count=64, seed=0):
        rng = np.random.default_rng(seed)
        self.arm = open_arm(name)
        self.mechanism = mechanism = mechanism_of(self.arm)
        self.command = rng.uniform(-0.17, 0.17, (count, 8))
        self.segment = rng.integers(1, 5, count)
        self.place_m = rng.uniform(0.015, 0.13, count)
        size, angle = rng.uniform(1.0, LARGEST_N[name], count), rng.uniform(0.0, 6.28, count)
        along = rng.uniform(-0.3, 0.3, count)
        self.force_n = size[:, None] * np.stack([along, np.sin(angle), np.cos(angle)], axis=1)
        every, n = np.arange(count), self.segment - 1
        at_m, forces = np.tile(mechanism.contact_m, (count, 1)), np.zeros((count, 4, 3))
        at_m[every, n] = self.place_m
        axes = kinematics.segment_rotations(mechanism, self.command)[every, n]
        forces[every, n] = np.einsum("bij,bj->bi", axes, self.force_n)
        touched = replace(mechanism, contact_m=at_m)
        self.unloaded_n = solve_equilibrium(mechanism, self.command).tensions_n
        loaded_n = solve_equilibrium(touched, self.command, forces).tensions_n
        self.difference_n = np.maximum(loaded_n, 0.0) - self.unloaded_n


@pytest.fixture(scope="module", params=LARGEST_N)
def pushed(request):
    return Pushed(request.param)


@pytest.fixture(scope="module")
def model(pushed):
    return AnywhereEstimator.load(find_model(f"{pushed.arm.name}_anywhere"), pushed.arm)


def test_the_untrained_network_makes_the_balance_that_numpy_makes(pushed):
    variance_n2 = difference_variance_n2(pushed.arm.sensors, TARE_SAMPLES)
    expected = torque_balance(pushed.mechanism, pushed.command, pushed.difference_n, variance_n2)
    samples = torch.as_tensor(pushed.difference_n), torch.as_tensor(pushed.command)
    with torch.no_grad():
        found = AnywhereStatics.for_arm(pushed.arm, TARE_SAMPLES)(*samples)
    for name, tolerance in (("torque_n_m", 2e-4), ("by_force_m", 1e-5), ("by_place", 1e-4)):
        actual, wanted = getattr(found, name).numpy(), getattr(expected, name)
        np.testing.assert_allclose(actual, wanted, atol=tolerance * np.abs(wanted).max())
    weight = np.abs(expected.precision).max(axis=(1, 2))[:, None, None]
    np.testing.assert_allclose(
        found.precision.numpy() / weight, expected.precision / weight, atol=0.02
    )


def test_further_torques_widen_what_is_stated_by_their_covariance(pushed, model):
    """Three times the variance of noise makes twice the standard deviations (least squares)."""
    strong = np.argmax((pushed.segment == 3) * np.linalg.norm(pushed.force_n, axis=1))
    sample = pushed.difference_n[strong], pushed.command[strong]
    alone = model.estimate(*sample)
    balance, _ = model.balance_batch(*sample)
    model.torque_covariance_n2_m2 = 3.0 * np.linalg.inv(balance.precision[0])
    try:
        widened = model.estimate(*sample)
        assert model.estimate(*sample).magnitude_std_n == widened.magnitude_std_n
    finally:
        model.torque_covariance_n2_m2 = None
    assert model.estimate(*sample).magnitude_std_n == alone.magnitude_std_n
    assert widened.magnitude_n == pytest.approx(alone.magnitude_n, abs=0.05)
    for name in ("magnitude_std_n", "angle_std_deg"):
        assert getattr(widened, name) == pytest.approx(2.0 * getattr(alone, name), rel=0.05)
    std_m = [each.place.covariance[0, 0] ** 0.5 for each in (alone, widened)]
    assert std_m[1] == pytest.approx(2.0 * std_m[0], rel=0.05)


def test_without_noise_the_contact_is_exact_and_nothing_is_left(pushed, model):
    found, misfit = model.locate_batch(pushed.difference_n, pushed.command)
    beyond = pushed.segment > 1
    np.testing.assert_array_equal(found.segment, pushed.segment)
    assert np.median(np.abs(found.place_m - pushed.place_m)[beyond]) < 2e-5
    lateral_off = np.linalg.norm((found.force_n - pushed.force_n)[beyond, 1:], axis=1)
    assert np.median(lateral_off) < 0.02
    # a cable within four standard deviations of slack counts as slack
    assert np.median(misfit) < 0.1
    assert misfit.max() < 1.5


def test_one_sample_is_answered_as_in_a_batch(pushed, model):
    assert isinstance(model, Estimator)
    batch = model.estimate_batch(pushed.difference_n, pushed.command)
    _, misfit = model.locate_batch(pushed.difference_n, pushed.command)
    for k in range(8):
        one = model.estimate(pushed.difference_n[k], pushed.command[k])
        assert one.segment == batch.segment[k]
        assert one.magnitude_n == pytest.approx(batch.magnitude_n[k], rel=1e-6)
        assert one.place.low_m <= one.place.place_m <= one.place.high_m
        assert one.place.misfit == pytest.approx(misfit[k], abs=1e-3)


@pytest.mark.parametrize("cable", range(12))
def test_a_wrong_reading_shows_in_the_misfit(pushed, model, cable):
    wrong = pushed.difference_n.copy()
    taut = wrong[:, cable] + pushed.unloaded_n[:, cable] > 5.0
    wrong[:, cable] += 20.0
    _, misfit = model.locate_batch(wrong, pushed.command)
    assert np.median(misfit[taut]) > 5.0


def test_a_network_that_learnt_a_factor_states_wider_torques(pushed):
    network = AnywhereStatics.for_arm(pushed.arm, TARE_SAMPLES)
    samples = torch.as_tensor(pushed.difference_n), torch.as_tensor(pushed.command)
    before = network(*samples).precision
    network.spread.factor.fill_(2.0)
    torch.testing.assert_close(network(*samples).precision, 0.25 * before)
