"""Lags of sensors are undone from one reading to the next, and noise grows by what is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from cablesense_sim.arm import Arm, ListedEffect, open_arm
from cablesense_sim.build import entries_of
from cablesense_sim.replay import replay_arm
from cablesense_training.data.history import sensed_along_n
from cablesense_training.errors import TrainingError
from cablesense_training.inference.temporal_estimator import (
    TemporalEstimator,
    TemporalState,
    TickClock,
)
from cablesense_training.model_training import draw_training_data, train_model
from cablesense_training.networks.temporal import Ticks
from cablesense_training.networks.unlagged import (
    UnlaggedClosedForm,
    added_noise_n,
    settled_sensors,
    tick_s,
)
from cablesense_training.recipes import adjusted, recipe_for

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


def test_without_a_past_sensors_count_as_settled() -> None:
    network = UnlaggedClosedForm.for_arm(lagging(0.5, "arm"))
    reading_n = torch.linspace(-20.0, 30.0, 12, dtype=torch.float64)[None]
    state = torch.zeros(1, network.own_state, dtype=torch.float64)
    for _ in range(3):
        tension_n, state = network.undo(reading_n, state)
        torch.testing.assert_close(tension_n, reading_n)


@pytest.mark.slow  # exports a model
def test_a_pause_of_the_samples_makes_no_larger_force(tmp_path: Path) -> None:
    arm, path = lagging(0.0, "arm"), tmp_path / "unlagged.onnx"
    data = draw_training_data(arm, "unlagged", {"samples": 256}, seed=0)
    settings = adjusted(recipe_for("unlagged").settings, seed=0, threads=1, epochs=1)
    train_model(path, "unlagged", data, settings, command="by a test", test_samples=16)
    estimator, still = TemporalEstimator.load(path), np.zeros(8)
    forces_n = np.zeros((2, 4, 3))
    forces_n[1, 2, 2] = -10.0
    tensions_n = replay_arm(settled_sensors(arm), np.arange(2.0), np.zeros((2, 8)), forces_n)
    difference_n = tensions_n[1] - tensions_n[0]
    for time_s in (0.0, 0.2, 0.4, 5.0, 5.2):
        found = estimator.estimate(difference_n, still, still, still, time_s)
        assert found.magnitude_n == pytest.approx(10.0, rel=0.03)
    estimator.tare()  # as undoing a tare does, while the force acts
    found = estimator.estimate(difference_n, still, still, still, 5.4)
    assert found.magnitude_n == pytest.approx(10.0, rel=0.03)


def test_noise_grows_where_a_sensor_lags_and_there_alone() -> None:
    arm = lagging(0.0, "cable_3")
    network = UnlaggedClosedForm.for_arm(arm)
    noise_n = np.random.default_rng(0).normal(0.0, 1.0, (20_000, 12))
    nothing = torch.zeros(len(noise_n), network.own_state, dtype=torch.float64)
    nothing[:, -1] = 1.0
    grown_n = network.undo(torch.as_tensor(noise_n), nothing)[0].numpy().std(axis=0)
    assert grown_n[2] > 2.0
    assert np.delete(grown_n, 2) == pytest.approx(1.0, abs=0.02)
    assert (added_noise_n(arm, 50) > 0.0).tolist() == [k == 2 for k in range(12)]


def test_settled_it_answers_as_without_a_state() -> None:
    network = UnlaggedClosedForm.for_arm(lagging(0.3, "arm")).eval()
    difference = torch.randn(5, 12, dtype=torch.float64)
    still = torch.zeros(5, 8, dtype=torch.float64)
    state = torch.zeros(5, network.memory, dtype=torch.float64)
    state[:, : network.own_state - 1] = difference.repeat(1, 2)
    state[:, network.own_state - 1] = 1.0
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


def test_ticks_longer_than_the_usual_gap_have_a_past() -> None:
    clock = TickClock(1.7)
    assert clock.ticks(0.0) is None
    clock.advance(0.0, None)
    assert [clock.ticks(time_s) for time_s in (1.2, 1.7, 3.3, 3.5)] == [0, 1, 2, None]
