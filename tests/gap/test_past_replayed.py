"""Estimates with the past known, by the shipped model on readings of arms with planted effects."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap_recordings import LAB, small_recording

from cablesense_base.arrays import Array
from cablesense_base.installation import config_path
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.retraining import (
    TaredLoads,
    answered_n,
    answers_with_past,
    arm_alone,
    estimator_figures,
    tared_loads,
)
from cablesense_sim.arm import Arm, ListedEffect
from cablesense_sim.build import mechanism_of
from cablesense_sim.replay import replay_arm
from cablesense_training.inference.estimator import Estimator

COURSE = small_recording()
ARM = mechanism_of(LAB)
LAG = ListedEffect(effect="sensor_lag", at="cable_3", parameters={"time_constant_s": 0.6})
GAIN = ListedEffect(effect="sensor_gain", at="cable_1", parameters={"gain": 0.15})
RUBBING = ListedEffect(
    effect="capstan_friction", parameters={"coefficient": 0.25, "give_m": 5e-6, "run_share": 1.0}
)
PAYLOAD = ListedEffect(effect="payload", at="segment_2", parameters={"mass_kg": 0.4})


def having(*effects: ListedEffect) -> Arm:
    return LAB.model_copy(update={"effects": list(effects)})


def recorded(arm: Arm) -> Recording:
    read = replay_arm(arm, COURSE.time_s, COURSE.command_rad, COURSE.forces_n)
    return replace(COURSE, tensions_n=read)


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
    before = estimator_figures(ARM, loads, answer(loads))
    after = estimator_figures(ARM, loads, answers_with_past(recording, arm, answer))
    assert after["contact_accuracy"] == 1.0
    return before["force_mae_n"], after["force_mae_n"]


@pytest.mark.parametrize("effect", [LAG, GAIN, RUBBING], ids=lambda e: e.effect)
def test_what_no_sample_tells_is_at_least_halved(effect: ListedEffect):
    before_n, after_n = errors_n(having(effect))
    assert after_n < 0.5 * before_n


def test_an_arm_whose_effects_are_statics_needs_no_past():
    recording = recorded(having(PAYLOAD))
    expected = answer(tared_loads(recording))
    assert np.array_equal(answers_with_past(recording, having(PAYLOAD), answer), expected)


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
