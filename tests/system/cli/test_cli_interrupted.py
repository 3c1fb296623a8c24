"""A diagnosis that Ctrl-C stops goes on from there, and ends as one that was never stopped."""

from __future__ import annotations

import json
import signal
from dataclasses import replace

import numpy as np
import pytest

from cablesense_base.progress import StagedProgress
from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_recording.csv_file import write_csv
from cablesense_sim.effects.registry import known_effects
from cablesense_sim.replay import read_tensions_n, replay_arm
from tests.helpers.gap_recordings import LAB, propose_no_experiment, small_recording

DIAGNOSE = ("gap", "diagnose", "new.csv", "--workers", 1, "--out")
ENDED_BY_SIGINT = 130


@pytest.fixture
def simulated(monkeypatch):
    """Numbers of variants that the simulator was asked for, call by call."""
    counts = []
    predict = ArmSimulator.predict

    def counted(simulator, variants):
        counts.append(len(variants))
        return predict(simulator, variants)

    monkeypatch.setattr(ArmSimulator, "predict", counted)
    return counts


@pytest.fixture
def stopped_at(monkeypatch):
    """Sends SIGINT once, as soon as the share of the diagnosis that is done reaches a value."""
    waiting = []
    show = StagedProgress.show

    def stopping(progress, doing, done):
        show(progress, doing, done)
        if waiting and done >= waiting[0]:
            waiting.clear()
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(StagedProgress, "show", stopping)
    return waiting.append


@pytest.fixture
def few_effects(monkeypatch):
    """Two effects to choose from, so that a diagnosis takes a second."""
    few = {
        name: effect
        for name, effect in known_effects().items()
        if effect.tolerance or name in ("payload", "pretension_error")
    }
    monkeypatch.setattr("cablesense_gap.arm_simulator.known_effects", lambda: few)


def verdict_in(folder):
    content = json.loads((folder / "verdict.json").read_text(encoding="utf-8"))
    del content["seconds"]
    return content


@pytest.mark.slow
@pytest.mark.usefixtures("few_effects")
def test_the_same_command_goes_on_with_what_was_simulated(
    command, tmp_path, simulated, stopped_at, monkeypatch
):
    monkeypatch.setattr("cablesense_gap.kept_simulations._WORTH_KEEPING_S", 0.0)
    propose_no_experiment(monkeypatch)
    payload = {"effect": "payload", "at": "segment_3", "parameters": {"mass_kg": 0.5}}
    heavy = LAB.model_validate({**LAB.model_dump(), "effects": [payload]})
    protocol = small_recording(peak_n=25.0)
    protocol = protocol.rows(np.arange(0, len(protocol), 4))
    ideal_n = replay_arm(heavy, protocol.course)
    read_n = read_tensions_n(ideal_n, LAB.sensors, np.random.default_rng(4))
    write_csv(tmp_path / "new.csv", replace(protocol, tensions_n=read_n))

    stopped_at(0.6)
    stopped = command(*DIAGNOSE, "stopped")
    assert stopped.returncode == ENDED_BY_SIGINT
    assert "the same command goes on from there" in stopped.stdout
    assert not (tmp_path / "stopped/verdict.json").exists()
    kept = list((tmp_path / "stopped/unfinished").rglob("*.npy"))
    assert len(kept) > 10

    simulated.clear()
    resumed = command(*DIAGNOSE, "stopped")
    assert resumed.returncode == 0, resumed.stderr
    assert f"{len(kept)} of its simulations" in resumed.stdout
    simulated_after = sum(simulated)
    assert {path.name for path in (tmp_path / "stopped").iterdir()} == {
        "verdict.json",
        "amended_arm.yaml",
        "report.html",
    }

    simulated.clear()
    assert command(*DIAGNOSE, "whole").returncode == 0
    assert simulated_after < 0.7 * sum(simulated)
    assert verdict_in(tmp_path / "stopped") == verdict_in(tmp_path / "whole")


def test_simulations_of_another_recording_are_not_taken(tmp_path):
    from cablesense_gap.kept_simulations import KeptSimulations

    file = tmp_path / "new.csv"
    file.write_text("one", encoding="utf-8")
    first = KeptSimulations.of_command(tmp_path, [file], ["diagnose"])
    first.folder.mkdir(parents=True)
    np.save(first.folder / "asked.npy", np.zeros(3))
    assert KeptSimulations.of_command(tmp_path, [file], ["diagnose"]).count == 1
    copy = tmp_path / "copied.csv"
    copy.write_text("one", encoding="utf-8")
    assert KeptSimulations.of_command(tmp_path, [copy], ["diagnose"]).count == 1
    file.write_text("two", encoding="utf-8")
    other = KeptSimulations.of_command(tmp_path, [file], ["diagnose"])
    assert other.count == 0
    assert not first.folder.exists()
