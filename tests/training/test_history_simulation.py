"""Readings of arms that stick, creep or have play, freed of it by a simulation beside them."""

from dataclasses import replace

import numpy as np
import pytest
from gap_recordings import LAB, small_recording

from cablesense_gap.recorded_contacts import tares_n, without_history_n
from cablesense_sim.arm import Arm, ListedEffect
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import normal_force_n
from cablesense_sim.replay import read_tensions_n, replay_arm
from cablesense_training.errors import EstimateError, TrainingError
from cablesense_training.inference.history_simulation import (
    HistoryEstimator,
    HistorySimulation,
    depends_on_history,
    remembered,
    without_history,
)
from cablesense_training.inference.metadata import find_model
from cablesense_training.inference.temporal_estimator import open_estimator
from cablesense_training.model_training import build_network

PROTOCOL = small_recording()
STILL = np.zeros(LAB.joint_count)
TARE = 50
STICKING = ListedEffect(
    effect="capstan_friction",
    parameters={"coefficient": 0.08, "pulley_wrap_rad": 1.0, "give_m": 2e-5},
)
CREEPING = ListedEffect(effect="cable_creep", parameters={"share": 0.2, "time_s": 20.0})
PLAY = ListedEffect(effect="actuator_backlash", at="cable_4", parameters={"play_m": 1e-4})
LAG = ListedEffect(effect="sensor_lag", parameters={"time_constant_s": 0.3})
SHORT_LAGS = [
    LAG.model_copy(update={"parameters": {"time_constant_s": first, "second_share": second}})
    for first, second in ((0.11, 0.0), (0.07, 0.5), (0.05, 1.0))
]


def having(*effects: ListedEffect) -> Arm:
    return LAB.model_copy(update={"effects": list(effects)})


def read_by(arm: Arm, *, evenly: bool = False) -> np.ndarray:
    """Readings (R, M) of the protocol; loads change `evenly`, or right after the last sample."""
    changed, each = PROTOCOL, 1
    if not evenly:
        twice = np.repeat(np.arange(len(PROTOCOL)), 2)
        time_s = PROTOCOL.time_s[twice[:-1]] + np.resize([0.0, 1e-3], len(twice) - 1)
        changed, each = replace(PROTOCOL.rows(twice[1:]), time_s=time_s), 2
    true_n = replay_arm(arm, *changed.inputs)[::each]
    return read_tensions_n(true_n, LAB.sensors, np.random.default_rng(0))


def differences(arm: Arm, *, evenly: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Those of an arm in rows with a tare, the same without its history, and of a plain arm."""
    recording = replace(PROTOCOL, tensions_n=read_by(arm, evenly=evenly))
    tare_n = tares_n(recording)
    rows = np.isfinite(tare_n).all(axis=1)
    freed_n, _ = without_history_n(recording, tare_n, HistorySimulation(arm, TARE))
    plain = replace(PROTOCOL, tensions_n=read_by(without_history(arm)))
    return (
        (recording.tensions_n - tare_n)[rows],
        freed_n[rows],
        (plain.tensions_n - tares_n(plain))[rows],
    )


def rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


@pytest.mark.slow
@pytest.mark.parametrize("arm", [having(STICKING, CREEPING, LAG), *map(having, SHORT_LAGS)])
def test_readings_become_those_of_the_arm_without_its_history(arm: Arm) -> None:
    """Cables stick and creep, sensors lag; or sensors lag by less than the time of a sample."""
    raw_n, freed_n, plain_n = differences(arm, evenly=len(arm.effects) == 1)
    assert rms(raw_n - plain_n) > 5.0 * LAB.sensors.noise_std_n
    assert rms(freed_n - plain_n) < 0.2 * rms(raw_n - plain_n)


def test_an_arm_that_moves_untouched_shows_no_load() -> None:
    arm = having(STICKING)
    rng = np.random.default_rng(1)
    command = np.cumsum(rng.normal(0.0, np.deg2rad(0.7), (40, LAB.joint_count)), axis=0)
    time_s, none = 0.1 * np.arange(len(command)), np.zeros((len(command), LAB.segment_count, 3))
    read_n = replay_arm(arm, time_s, command, none)
    difference_n = read_n - replay_arm(LAB, time_s, command, none)  # as a tare is carried over
    simulation = HistorySimulation(arm, TARE)
    simulation.unloaded(time_s[0], command[0])
    for row in range(1, len(command)):
        freed = simulation.without_n(
            difference_n[row] - difference_n[0], time_s[row], command[row]
        )
        np.testing.assert_allclose(freed, 0.0, atol=0.01)
        assert not simulation.touched


def test_the_same_samples_give_the_same_again_after_forgetting() -> None:
    simulation = HistorySimulation(having(STICKING), TARE)
    recording = PROTOCOL.rows(slice(0, 50))
    recording = replace(recording, tensions_n=read_by(having(STICKING))[:50])
    first, second = (without_history_n(recording, tares_n(recording), simulation)[0] for _ in "ab")
    np.testing.assert_array_equal(first, second)


def test_the_past_of_a_recording_is_not_that_of_the_next_one() -> None:
    begun = {"torque_n_m": 0.5, "start_pitch": 0.9}
    joint = ListedEffect(effect="joint_friction", at="joint_2", parameters=begun)
    cell = ListedEffect(effect="load_cell", parameters={})
    drift = ListedEffect(effect="sensor_drift", at="cable_1", parameters={})
    arm = having(STICKING, joint, cell, drift)
    kept = remembered(arm).effects
    assert [each.effect for each in kept] == ["capstan_friction", "joint_friction"]
    assert kept[1].parameters == {"torque_n_m": 0.5}


def test_what_depends_on_history_is_told_from_what_does_not() -> None:
    softer = ListedEffect(effect="cable_stiffness", parameters={"change": -0.2})
    gain = ListedEffect(effect="sensor_gain", at="cable_1", parameters={"gain": 0.1})
    arm = having(softer, gain, LAG, PLAY)
    assert [each.effect for each in without_history(arm).effects] == [
        "cable_stiffness",
        "sensor_gain",
    ]
    assert depends_on_history(arm)
    assert depends_on_history(having(LAG))
    assert not depends_on_history(having(softer, gain))
    with pytest.raises(TrainingError, match="lists friction, creep"):
        build_network("history-simulated", having(gain))


@pytest.fixture(scope="module")
def estimator() -> HistoryEstimator:
    found = open_estimator(find_model("cdsm_friction_simulated"))
    assert isinstance(found, HistoryEstimator)
    return found


def test_a_force_is_known_while_it_rises_and_while_it_falls(estimator: HistoryEstimator) -> None:
    ramp_n = np.linspace(0.0, 40.0, 21)
    sizes_n = np.concatenate([np.zeros(20), ramp_n, np.full(5, 40.0), ramp_n[::-1], np.zeros(5)])
    arm, count = estimator.metadata.arm, len(sizes_n)
    command = np.repeat(np.deg2rad([[3.0, -4.0, 2.0, 5.0, -3.0, 1.0, 4.0, -2.0]]), count, axis=0)
    command[:18] *= np.linspace(0.0, 1.0, 18)[:, None]
    forces_n = normal_force_n(mechanism_of(arm), command, 3, 60.0, sizes_n)
    time_s = 0.1 * np.arange(count)
    read_n = replay_arm(arm, time_s, command, forces_n)
    read_n -= replay_arm(arm.nominal, time_s, command, 0.0 * forces_n)  # as a tare is carried over
    estimator.forget()
    found = []
    for row in range(count):
        if row <= 18:
            estimator.tare()
        difference_n = read_n[row] - read_n[min(row, 18)]
        found.append(estimator.estimate(difference_n, command[row], STILL, STILL, time_s[row]))
    segment, _, magnitude_n, _, _, low_n, high_n = np.array([each[1:8] for each in found]).T
    firm = sizes_n > 5.0
    assert (segment[firm] == 3).all()
    off_n = magnitude_n[firm] - sizes_n[firm]
    assert np.median(np.abs(off_n)) < 0.1
    assert np.abs(off_n).max() < 2.5  # friction hides that a force has begun to fall
    assert ((low_n <= sizes_n) & (sizes_n <= high_n))[firm].mean() > 0.9
    assert (segment[-4:] == 0).all()  # no contact remains after release


def test_samples_between_ticks_are_answered_with_the_history_of_the_last(
    estimator: HistoryEstimator,
) -> None:
    difference_n = np.zeros(LAB.cable_count)
    estimator.forget()
    estimator.estimate(difference_n, STILL, STILL, STILL, 10.0)
    difference_n[8] = 5.0
    early = estimator.estimate(difference_n, STILL, STILL, STILL, 10.001)
    late = estimator.estimate(difference_n, STILL, STILL, STILL, 10.2)
    assert early.magnitude_n > 0.0
    assert late.magnitude_n != early.magnitude_n
    back = estimator.estimate(difference_n, STILL, STILL, STILL, 3.0)
    assert np.isfinite(back.magnitude_n)
    for bad, message in ((np.full(LAB.cable_count, np.nan), "finite"), (np.zeros(3), "shape")):
        with pytest.raises(EstimateError, match=message):
            estimator.estimate(bad, STILL, STILL, STILL, 0.0)
