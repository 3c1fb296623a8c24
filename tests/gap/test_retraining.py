"""The estimator before and after a diagnosis, on recordings with planted effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_recordings import LAB, small_recording

from cablesense_base.installation import config_path
from cablesense_gap import retraining
from cablesense_gap.arm_simulator import amended_arm
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.retraining import (
    Answering,
    RetrainingError,
    answered_n,
    estimator_errors,
    estimator_figures,
    tared_loads,
)
from cablesense_gap.simulator import Term
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.replay import replay_arm
from cablesense_training.inference.estimator import Estimator

COURSE = small_recording()
ARM = mechanism_of(LAB)
GAIN = Term("sensor_gain", "cable_1", "gain")
ZERO = Term("cable_tolerance", "cable_2", "zero_n")


def recorded(arm: Arm) -> Recording:
    read = replay_arm(arm, COURSE.time_s, COURSE.command_rad, COURSE.forces_n)
    return replace(COURSE, tensions_n=read)


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

    monkeypatch.setattr(retraining, "_trained", trained)
    return asked


def test_a_wrong_scale_is_taken_off(trained_before: list[Arm]):
    amended = amended_arm(LAB, {GAIN: 0.3}, {})
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
        COURSE, load_segment=np.zeros_like(COURSE.load_segment), load_n=0.0 * COURSE.load_n
    )
    with pytest.raises(RetrainingError, match="small: no load"):
        estimator_errors(idle, LAB, LAB)


@pytest.mark.slow  # trains, and exports the model
def test_a_small_budget_of_training_is_enough():
    recording = recorded(LAB)
    loads = tared_loads(recording)
    figures = estimator_figures(ARM, loads, retraining._trained(LAB, ARM, recording)(loads))
    assert figures["contact_accuracy"] == 1.0
    assert figures["force_mae_n"] < 0.2
    assert figures["direction_mean_deg"] < 0.5
