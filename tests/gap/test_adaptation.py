"""From a recording to an estimator that knows the arm, and when the first one is kept."""

from __future__ import annotations

import shutil
from collections.abc import Collection
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from gap_recordings import LAB, small_recording
from verdict_cases import verdict_of

from cablesense_gap import adaptation
from cablesense_gap.adaptation import AdaptationError, adapt, withheld_trials
from cablesense_gap.arm_system import Diagnosis
from cablesense_gap.recorded_contacts import at_contact_points
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.verdict import Share
from cablesense_sim.arm import Arm, ListedEffect
from cablesense_sim.replay import read_tensions_n, replay_arm
from cablesense_training.inference.metadata import HISTORY_SIMULATED, find_model

PROTOCOL = small_recording()
SHIPPED = find_model("cdsm_lab")
OFFSETS = [
    ListedEffect(effect="contact_offset", at=f"segment_{n}", parameters={"offset_m": -0.02})
    for n in range(1, 5)
]
GAIN = ListedEffect(effect="sensor_gain", at="cable_1", parameters={"gain": 0.3})
LAG = ListedEffect(effect="sensor_lag", parameters={"time_constant_s": 0.5})
SHARE = Share(share_n=1.0, ci95_n=(0.9, 1.1), left_n=0.1, probability=1.0)


def having(*effects: ListedEffect) -> Arm:
    return LAB.model_copy(update={"effects": list(effects)})


def recorded(arm: Arm) -> Recording:
    true_n = replay_arm(arm, *PROTOCOL.inputs)
    readings = read_tensions_n(true_n, LAB.sensors, np.random.default_rng(0))
    return replace(PROTOCOL, tensions_n=readings)


@cache
def healthy() -> Recording:
    return recorded(LAB)


@pytest.fixture
def diagnosed_as(monkeypatch: pytest.MonkeyPatch):
    """Puts a diagnosis that names just these effects in place of one that takes its time."""
    asked: list[Collection[int]] = []

    def put(*effects: ListedEffect) -> list[Collection[int]]:
        def diagnose(
            recording: Recording,
            arm: Arm,
            *others: object,
            unseen: Collection[int] = (),
            force: bool = False,
        ) -> Diagnosis:
            asked.append(unseen or others[-1])
            shares = {effect.effect: SHARE for effect in effects}
            names = "+".join(sorted(shares)) or "none"
            read = recording.tensions_n
            verdict = verdict_of(names, shares=shares)
            every = np.ones(len(recording), dtype=bool)
            return Diagnosis(recording, arm, verdict, having(*effects), read, read, every)

        monkeypatch.setattr(adaptation, "diagnose", diagnose)
        return asked

    return put


def test_the_trials_withheld_trials_have_loads_and_leave_each_segment_to_learn_from():
    places = replace(PROTOCOL, load_at_m=np.where(PROTOCOL.trial % 3, 0.02, np.nan))
    apart = withheld_trials(places, LAB)
    assert 0 < len(apart) <= len(np.unique(PROTOCOL.trial)) / 3
    seen = ~np.isin(PROTOCOL.trial, apart)
    assert set(PROTOCOL.load_segment[seen]) == {0, 1, 2, 3, 4}
    assert PROTOCOL.load_segment[~seen & at_contact_points(places, LAB)].any()


def test_a_recording_without_loads_is_refused():
    idle = replace(
        PROTOCOL, load_segment=np.zeros_like(PROTOCOL.load_segment), load_n=0.0 * PROTOCOL.load_n
    )
    with pytest.raises(AdaptationError, match="small: 0 trials have a load"):
        withheld_trials(idle, LAB)


def test_an_arm_with_a_history_gets_an_estimator_that_simulates_it(
    tmp_path: Path, diagnosed_as, monkeypatch: pytest.MonkeyPatch
):
    """tests/packaging/test_tutorial.py trains one of contacts anywhere, and repairs the forces."""
    trained = []

    def train(path: Path, name: str, data, *_: object, **__: object) -> None:
        trained.append((name, data.arm.effects))
        shutil.copy(SHIPPED, path)

    monkeypatch.setattr(adaptation, "_SAMPLES", 64)
    monkeypatch.setattr(adaptation, "train_model", train)
    hidden = (*OFFSETS, GAIN, LAG)
    asked = diagnosed_as(*hidden)
    recording = recorded(having(*hidden))
    assert not adapt(recording, LAB, SHIPPED, tmp_path / "second.onnx", "by a test").better
    assert trained == [(HISTORY_SIMULATED, list(hidden))]
    assert asked == [withheld_trials(recording, LAB)]


def test_where_nothing_is_found_nothing_is_trained(tmp_path: Path, diagnosed_as):
    diagnosed_as()
    found = adapt(healthy(), LAB, SHIPPED, tmp_path / "second.onnx", "by a test")
    assert (found.better, found.after) == (False, None)
    assert found.diagnosis.verdict.estimator.use == "before"
    assert not list(tmp_path.iterdir())


def test_a_second_estimator_that_is_no_better_is_not_used(
    tmp_path: Path, diagnosed_as, monkeypatch: pytest.MonkeyPatch
):
    diagnosed_as(GAIN)
    monkeypatch.setattr(
        adaptation, "train_for", lambda arm, first, seen, unseen, at, *_: shutil.copy(SHIPPED, at)
    )
    found = adapt(healthy(), LAB, SHIPPED, tmp_path / "second.onnx", "by a test")
    assert not found.better
    assert found.after is not None
