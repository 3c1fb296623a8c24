"""`cablesense gap diagnose`: from a file to a folder, with the exit codes that others rely on."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from cablesense_gap.verdict import read_verdict
from cablesense_recording.csv_file import write_csv
from cablesense_recording.recording import Recording
from cablesense_sim.arm import Arm, load_arm
from cablesense_sim.replay import read_tensions_n, replay_arm
from tests.helpers.gap_recordings import LAB, propose_no_experiment, small_recording

PROTOCOL = small_recording(peak_n=25.0)
SHORT = PROTOCOL.rows(np.flatnonzero(np.arange(len(PROTOCOL)) % 4 == 0))


def recorded(arm: Arm, protocol: Recording = SHORT) -> Recording:
    ideal = replay_arm(arm, protocol.course)
    readings = read_tensions_n(ideal, arm.sensors, np.random.default_rng(4))
    return replace(protocol, tensions_n=readings)


@pytest.mark.slow  # the full library, from which to choose
def test_a_recording_becomes_a_folder_that_predicts(command, tmp_path, monkeypatch):
    propose_no_experiment(monkeypatch)
    payload = {"effect": "payload", "at": "segment_3", "parameters": {"mass_kg": 0.5}}
    heavy = LAB.model_validate({**LAB.model_dump(), "effects": [payload]})
    write_csv(tmp_path / "new.csv", recorded(heavy))
    done = command("gap", "diagnose", "new.csv", "--out", "found", "--workers", 1)
    assert done.returncode == 0, done.stderr
    assert "found/report.html" in done.stdout
    folder = tmp_path / "found"
    names = {path.name for path in folder.iterdir()}
    assert names == {"verdict.json", "amended_arm.yaml", "report.html"}
    verdict = read_verdict(folder / "verdict.json")
    assert (verdict.recording, verdict.arm) == ("new", "cdsm_lab")
    assert verdict.effects == ("payload",)
    assert verdict.where.segments == ("segment_3",)
    assert verdict.parameters["payload.mass_kg"].value == pytest.approx(0.5, rel=0.06)
    # the same rows count for the report, the verdict and the prediction
    sizes = {}
    for arm in ("cdsm_lab", "found"):
        verb = ("gap", "predict", "new.csv", "--arm", arm, "--out", f"{arm}.csv", "--json")
        done = command(*verb)
        sizes[arm] = json.loads(done.stdout)
        assert sizes[arm]["rows_counted"] == verdict.rows_counted
    gap = verdict.gap
    assert sizes["cdsm_lab"]["gap_n"] == pytest.approx(gap.before_n)
    assert sizes["found"]["gap_n"] == pytest.approx(gap.after_n, abs=0.5 * gap.floor_n)
    assert gap.after_n <= gap.effects_n < 0.3 * gap.before_n
    # on loads and poses that the diagnosis never saw
    unseen = replace(
        PROTOCOL, command_rad=-0.7 * PROTOCOL.command_rad, load_n=0.6 * PROTOCOL.load_n
    )
    real, after, before = (
        replay_arm(arm, unseen.course)
        for arm in (heavy, load_arm(folder / "amended_arm.yaml"), LAB)
    )
    assert ((after - real) ** 2).mean() < 0.05 * ((before - real) ** 2).mean()


def broken(recording: Recording, what: str) -> Recording:
    if what == "time that stands still":
        return replace(recording, time_s=0.0 * recording.time_s)
    if what == "degrees":
        return replace(recording, command_rad=np.rad2deg(recording.command_rad))
    if what == "another arm":
        other = np.random.default_rng(0).normal(50.0, 5.0, recording.tensions_n.shape)
        return replace(recording, tensions_n=other)
    if what == "exchanged plugs":
        order = [0, 4, 2, 3, 1, *range(5, 12)]
        return replace(recording, tensions_n=recording.tensions_n[:, order])
    return replace(recording, trial=0 * recording.trial)


@pytest.mark.parametrize(
    ("what", "text"),
    [
        ("time that stands still", "time_s"),
        ("degrees", "rad"),
        ("another arm", "give the arm file of this arm"),
        ("exchanged plugs", "tension_2_n reads cable_5, tension_5_n reads cable_2"),
        ("one trial", "2 trials"),
    ],
)
def test_a_recording_that_cannot_be_used_ends_with_2_and_one_line(command, tmp_path, what, text):
    write_csv(tmp_path / "new.csv", broken(recorded(LAB), what))
    result = command("gap", "diagnose", "new.csv", "--out", "found")
    assert result.returncode == 2
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith("cablesense: ")
    assert text in line
    assert not (tmp_path / "found").exists()
