"""Lags of sensors are undone from one reading to the next, and noise grows by what is said."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cablesense_sim.arm import Arm, ListedEffect, open_arm
from cablesense_sim.build import entries_of
from cablesense_training.data.history import sensed_along_n
from cablesense_training.errors import TrainingError
from cablesense_training.inference.temporal_estimator import TemporalState
from cablesense_training.networks.temporal import Ticks
from cablesense_training.networks.unlagged import UnlaggedClosedForm, added_noise_n, tick_s

LAB = open_arm("cdsm_lab")


def lagging(share: float, *at: str) -> Arm:
    numbers = {"time_constant_s": 0.6, "second_share": share}
    effects = [ListedEffect(effect="sensor_lag", at=place, parameters=numbers) for place in at]
    return LAB.model_copy(update={"effects": effects})


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_what_lags_is_known_from_its_past(share: float) -> None:
    arm = lagging(share, "cable_2", "cable_7")
    network = UnlaggedClosedForm.for_arm(arm)
    true_n = np.cumsum(np.random.default_rng(0).normal(0.0, 5.0, (40, 12)), axis=0)
    true_n -= true_n[0]
    time_s = tick_s(arm) * np.arange(len(true_n))
    read_n = sensed_along_n(entries_of(arm), time_s, true_n[:, None])[:, 0]
    assert np.abs(read_n - true_n).max() > 5.0
    state = torch.zeros(1, network.own_state, dtype=torch.float64)
    for reading_n, tension_n in zip(read_n, true_n, strict=True):
        found_n, state = network.undo(torch.as_tensor(reading_n)[None], state)
        np.testing.assert_allclose(found_n[0].numpy(), tension_n, atol=1e-9)


def test_a_recording_is_undone_by_its_own_times() -> None:
    arm = lagging(0.0, "arm")
    network = UnlaggedClosedForm.for_arm(arm)
    true_n = np.cumsum(np.random.default_rng(0).normal(0.0, 5.0, (40, 12)), axis=0)
    true_n -= true_n[0]
    tares_n = np.zeros_like(true_n)
    tares_n[:3] = np.nan
    time_s = tick_s(arm) * np.arange(len(true_n))
    read_n = sensed_along_n(entries_of(arm), time_s, true_n[:, None])[:, 0]
    found_n = network.undone_n(read_n - read_n[3] - tares_n, tares_n, time_s)
    assert np.isnan(found_n[:3]).all()
    later = slice(5, None)  # that the tare was taken while the sensors lagged has been forgotten
    np.testing.assert_allclose(found_n[later], true_n[later] - read_n[3], atol=1e-9)
    # over several ticks it takes the reading to have held, as the estimator does
    slow_n = network.undone_n(read_n, np.zeros_like(read_n), 3.0 * time_s)
    np.testing.assert_allclose(slow_n, read_n, atol=1e-9)


def test_noise_grows_where_a_sensor_lags_and_there_alone() -> None:
    arm = lagging(0.0, "cable_3")
    network = UnlaggedClosedForm.for_arm(arm)
    noise_n = np.random.default_rng(0).normal(0.0, 1.0, (20_000, 12))
    nothing = torch.zeros(len(noise_n), network.own_state, dtype=torch.float64)
    grown_n = network.undo(torch.as_tensor(noise_n), nothing)[0].numpy().std(axis=0)
    assert grown_n[2] > 2.0
    assert np.delete(grown_n, 2) == pytest.approx(1.0, abs=0.02)
    assert (added_noise_n(arm, 50) > 0.0).tolist() == [k == 2 for k in range(12)]


def test_settled_it_answers_as_without_a_state() -> None:
    network = UnlaggedClosedForm.for_arm(lagging(0.3, "arm")).eval()
    difference = torch.randn(5, 12, dtype=torch.float64)
    still = torch.zeros(5, 8, dtype=torch.float64)
    state = torch.zeros(5, network.memory, dtype=torch.float64)
    state[:, : network.own_state] = difference.repeat(1, 2)
    with torch.no_grad():
        output, following = network.tick(Ticks(difference, still, still, still), state)
        torch.testing.assert_close(output, network(difference, still))
    torch.testing.assert_close(following, state)
    layout = TemporalState.of_size(network.memory, network.own_state, 12, 8)
    assert layout.tared(following.numpy()).shape == following.shape


@pytest.mark.parametrize("places", [(), ("arm", "cable_1")])
def test_an_arm_without_one_lag_a_sensor_is_refused(places: tuple[str, ...]) -> None:
    with pytest.raises(TrainingError, match="once for each cable at most"):
        UnlaggedClosedForm.for_arm(lagging(0.0, *places))
