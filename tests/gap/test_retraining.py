"""The estimator before and after a diagnosis, on recordings with planted effects."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap_recordings import CYCLE, LAB, small_recording

from cablesense_base import Array
from cablesense_base.installation import config_path
from cablesense_gap import retraining
from cablesense_gap.arm_simulator import ArmSimulator, amended_arm
from cablesense_gap.diagnosis.problem import Problem
from cablesense_gap.pipeline import problem_of
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.retraining import (
    AT_PEAK,
    Answering,
    RetrainingError,
    TaredLoads,
    answered_n,
    answers_with_past,
    arm_alone,
    estimator_errors,
    force_errors,
    found_values,
    tared_loads,
    without_fold,
)
from cablesense_gap.simulator import Term
from cablesense_sim.arm import Arm, ListedEffect
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import contact_angle_deg, normal_force_n
from cablesense_sim.replay import read_tensions_n, replay_arm
from cablesense_training.inference.estimator import Estimates, Estimator

PROTOCOL = small_recording()


def test_the_tare_is_the_mean_of_the_unloaded_rows_just_before():
    rng = np.random.default_rng(0)
    readings = rng.normal(50.0, 1.0, PROTOCOL.tensions_n.shape)
    loads = tared_loads(replace(PROTOCOL, tensions_n=readings))
    second = np.flatnonzero(loads.trial == 2)[0]
    # four rows at the end of the cycle before it and four at its own beginning
    first = loads.row[second]
    tare = readings[first - 8 : first].mean(0)
    assert loads.tension_difference_n[second] == pytest.approx(readings[first] - tare)


def test_every_loaded_row_of_the_protocol_has_a_tare():
    loads = tared_loads(PROTOCOL)
    assert np.array_equal(loads.row, np.flatnonzero(PROTOCOL.load_segment))
    assert np.array_equal(loads.force_n, PROTOCOL.load_n[loads.row])
    assert np.array_equal(loads.segment, PROTOCOL.load_segment[loads.row])


def test_the_peak_is_of_each_trial():
    loads = tared_loads(PROTOCOL)
    expected = int((CYCLE >= AT_PEAK).sum())
    assert [int(loads.at_peak[loads.trial == t].sum()) for t in range(1, 9)] == [expected] * 8


def test_a_load_under_another_command_than_its_tare_is_left_out():
    command = PROTOCOL.command_rad.copy()
    loaded = np.flatnonzero(PROTOCOL.load_segment)[0]
    command[loaded:] += 0.01
    loads = tared_loads(replace(PROTOCOL, command_rad=command))
    assert loaded not in loads.row
    assert len(loads) < len(tared_loads(PROTOCOL))


def test_no_rest_no_tare():
    everywhere = np.ones_like(PROTOCOL.load_segment)
    assert len(tared_loads(replace(PROTOCOL, load_segment=everywhere))) == 0


LOADS = tared_loads(small_recording())
ARM = mechanism_of(LAB)
ANGLE_DEG = contact_angle_deg(ARM, LOADS.command_rad, LOADS.segment, LOADS.force_n)
SIZE_N = np.linalg.norm(
    normal_force_n(ARM, LOADS.command_rad, LOADS.segment, ANGLE_DEG, 1.0).sum(1) * LOADS.force_n,
    axis=1,
)


def answers(turned_deg: float = 0.0, more: float = 1.0, segment: int | None = None) -> Array:
    """All answers, turned by an angle and larger by a factor; the true segment or another."""
    segments = LOADS.segment if segment is None else np.full(len(LOADS), segment)
    nothing = np.zeros(len(LOADS))
    said = Estimates(
        probabilities=np.zeros((len(LOADS), 5)),
        segment=segments,
        angle_deg=ANGLE_DEG + turned_deg,
        magnitude_n=SIZE_N * more,
        magnitude_std_n=nothing,
        angle_std_deg=nothing,
        low_n=nothing,
        high_n=nothing,
    )
    return answered_n(ARM, LOADS, said)


def test_the_truth_has_no_error():
    errors = force_errors(ARM, LOADS, answers())
    assert errors["contact_accuracy"] == 1.0
    assert errors["force_mae_n"] == pytest.approx(0.0, abs=1e-9)
    assert errors["direction_mean_deg"] == pytest.approx(0.0, abs=1e-4)
    assert errors["loads"] == 8.0


def test_each_error_is_told_by_its_figure():
    errors = force_errors(ARM, LOADS, answers(turned_deg=-7.0, more=1.1))
    assert errors["direction_mean_deg"] == pytest.approx(7.0)
    assert errors["force_mae_n"] == pytest.approx(0.1 * SIZE_N[LOADS.at_peak].mean())


def test_no_contact_counts_as_no_force():
    errors = force_errors(ARM, LOADS, answers(segment=0))
    assert errors["contact_accuracy"] == 0.0
    assert errors["force_mae_n"] == pytest.approx(SIZE_N[LOADS.at_peak].mean())
    assert "direction_mean_deg" not in errors


def test_another_segment_is_not_right():
    assert force_errors(ARM, LOADS, answers(segment=2))["contact_accuracy"] == 0.25


LAG = ListedEffect(effect="sensor_lag", at="cable_3", parameters={"time_constant_s": 0.6})
GAIN = ListedEffect(effect="sensor_gain", at="cable_1", parameters={"gain": 0.15})
RUBBING = ListedEffect(effect="capstan_friction", parameters={"coefficient": 0.25})
PAYLOAD = ListedEffect(effect="payload", at="segment_2", parameters={"mass_kg": 0.4})


def having(*effects: ListedEffect) -> Arm:
    return LAB.model_copy(update={"effects": list(effects)})


def recorded(arm: Arm) -> Recording:
    read = replay_arm(arm, PROTOCOL.time_s, PROTOCOL.command_rad, PROTOCOL.forces_n)
    return replace(PROTOCOL, tensions_n=read)


@cache
def shipped() -> Estimator:
    return Estimator.load(config_path("models/cdsm_lab.onnx"), LAB)


def answer(loads: TaredLoads) -> Array:
    said = shipped().estimate_batch(loads.tension_difference_n, loads.command_rad)
    return answered_n(ARM, loads, said)


def errors_n(arm: Arm) -> tuple[float, float]:
    """Mean force errors on readings of an arm, without the past and with it."""
    recording = recorded(arm)
    loads = tared_loads(recording)
    before = force_errors(ARM, loads, answer(loads))
    after = force_errors(ARM, loads, answers_with_past(recording, arm, answer))
    assert after["contact_accuracy"] == 1.0
    return before["force_mae_n"], after["force_mae_n"]


@pytest.mark.slow
@pytest.mark.parametrize("effect", [LAG, GAIN, RUBBING], ids=lambda e: e.effect)
def test_what_no_sample_tells_is_at_least_halved(effect: ListedEffect):
    before_n, after_n = errors_n(having(effect))
    assert after_n < 0.5 * before_n


def test_an_arm_whose_effects_are_statics_needs_no_past():
    recording = recorded(having(PAYLOAD))
    expected = answer(tared_loads(recording))
    assert np.array_equal(answers_with_past(recording, having(PAYLOAD), answer), expected)


@pytest.mark.slow
def test_what_comes_later_changes_nothing_earlier():
    """An estimate uses its own reading and those before it."""
    arm, recording = having(LAG), recorded(having(LAG))
    half = len(recording) // 2
    changed = recording.tensions_n.copy()
    changed[half:] += 5.0
    loads = tared_loads(recording)
    before = answers_with_past(recording, arm, answer)
    after = answers_with_past(replace(recording, tensions_n=changed), arm, answer)
    assert after[loads.row < half] == pytest.approx(before[loads.row < half])


def test_the_arm_alone_keeps_what_acts_on_the_arm():
    assert arm_alone(having(LAG, PAYLOAD, RUBBING)).effects == [PAYLOAD]


RECORDING = small_recording(peak_n=25.0)
MASS = Term("payload", "segment_3", "mass_kg")
ZERO = Term("cable_tolerance", "cable_2", "zero_n")
TRUE_KG = 0.5


@cache
def problem() -> Problem:
    simulator = ArmSimulator(LAB, RECORDING)
    ideal = simulator.predict([{MASS: TRUE_KG}])[0]
    readings = read_tensions_n(ideal, LAB.sensors, np.random.default_rng(0))
    nominal = simulator.predict([{}])[0]
    return problem_of(replace(RECORDING, tensions_n=readings), simulator, nominal)


def test_found_is_what_the_nominal_arm_does_not_list_and_no_workshop_leaves():
    amended = amended_arm(LAB, {MASS: 0.45}, {ZERO: 0.02})
    assert found_values(LAB, amended) == {MASS: 0.45}
    assert found_values(amended, amended_arm(amended, {}, {ZERO: 0.03})) == {}


@pytest.mark.slow
def test_the_refit_finds_the_number_that_is_true():
    fitted = without_fold(problem(), 1, LAB, amended_arm(LAB, {MASS: 0.3}, {}))
    assert found_values(LAB, fitted) == {MASS: pytest.approx(TRUE_KG, rel=0.05)}


def test_trials_of_the_fold_have_no_say():
    held_out = problem().fold[problem().trial] == 1
    spoilt = problem().readings + np.where(held_out, 30.0, 0.0)[:, None]
    amended = amended_arm(LAB, {MASS: 0.4}, {})
    expected = without_fold(problem(), 1, LAB, amended)
    assert without_fold(replace(problem(), readings=spoilt), 1, LAB, amended) == expected
    assert without_fold(replace(problem(), readings=spoilt), 2, LAB, amended) != expected


GAIN_TERM = Term("sensor_gain", "cable_1", "gain")


@pytest.fixture
def trained_before(monkeypatch: pytest.MonkeyPatch) -> list[Arm]:
    """The shipped model in place of training, which takes seconds; the arms asked for."""
    asked: list[Arm] = []
    shipped = Estimator.load(config_path("models/cdsm_lab.onnx"), LAB)

    def trained(arm: Arm, *_: object) -> Answering:
        asked.append(arm)
        return lambda loads: answered_n(
            ARM, loads, shipped.estimate_batch(loads.tension_difference_n, loads.command_rad)
        )

    monkeypatch.setattr(retraining, "trained_answering", trained)
    return asked


@pytest.mark.slow
def test_a_wrong_scale_is_taken_off(trained_before: list[Arm]):
    amended = amended_arm(LAB, {GAIN_TERM: 0.3}, {})
    errors = estimator_errors(recorded(amended), LAB, amended)
    assert errors.before["force_mae_n"] > 1.0
    assert errors.after["force_mae_n"] < 0.5 * errors.before["force_mae_n"]
    assert errors.after["contact_accuracy"] == 1.0
    assert trained_before[0] == LAB
    # one for each fold, none of which sees the sensor's fault
    assert len(trained_before) == 6
    assert not any(e.effect == "sensor_gain" for arm in trained_before for e in arm.effects)


def test_with_nothing_found_nothing_changes(trained_before: list[Arm]):
    amended = amended_arm(LAB, {}, {ZERO: 0.05})
    errors = estimator_errors(recorded(LAB), LAB, amended)
    assert errors.before == errors.after
    assert errors.before["force_mae_n"] < 0.2
    assert len(trained_before) == 1


def test_a_recording_without_loads_is_refused():
    idle = replace(
        PROTOCOL, load_segment=np.zeros_like(PROTOCOL.load_segment), load_n=0.0 * PROTOCOL.load_n
    )
    with pytest.raises(RetrainingError, match="small: no load"):
        estimator_errors(idle, LAB, LAB)


@pytest.mark.slow  # trains, and exports the model
def test_a_small_budget_of_training_is_enough(monkeypatch):
    monkeypatch.setattr(retraining, "SAMPLES", 512)
    monkeypatch.setattr(retraining, "EPOCHS", 2)
    recording = recorded(LAB)
    loads = tared_loads(recording)
    errors = force_errors(ARM, loads, retraining.trained_answering(LAB, ARM, recording)(loads))
    assert errors["contact_accuracy"] == 1.0
    assert errors["force_mae_n"] < 0.2
    assert errors["direction_mean_deg"] < 0.5
