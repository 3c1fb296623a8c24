"""`cablesense gap diagnose`: from a file to a folder, with the exit codes that others rely on."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from gap_recordings import LAB, small_recording

from cablesense_gap.recordings.csv_file import write_csv
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.verdict import read_verdict
from cablesense_sim.arm import Arm, load_arm
from cablesense_sim.replay import replay_arm
from cablesense_sim.sensors import read_tensions_n

COMMAND = [sys.executable, "-c", "from cablesense_cli.app import main; main()", "gap"]
PROBLEM = small_recording(peak_n=25.0)
SHORT = PROBLEM.rows(np.flatnonzero(np.arange(len(PROBLEM)) % 4 == 0))


def run(*arguments, cwd):
    return subprocess.run(
        [*COMMAND, *map(str, arguments)], cwd=cwd, capture_output=True, text=True, timeout=110
    )


def recorded(arm: Arm, problem: Recording = SHORT) -> Recording:
    ideal = replay_arm(arm, problem.time_s, problem.command_rad, problem.forces_n)
    readings = read_tensions_n(ideal, arm.sensors, np.random.default_rng(4))
    return replace(problem, tensions_n=readings)


@pytest.mark.slow  # the full library, from which to choose, in a process of its own
def test_a_recording_becomes_a_folder_that_predicts(tmp_path):
    payload = {"effect": "payload", "at": "segment_3", "parameters": {"mass_kg": 0.5}}
    heavy = LAB.model_validate({**LAB.model_dump(), "effects": [payload]})
    write_csv(tmp_path / "new.csv", recorded(heavy))
    done = run("diagnose", "new.csv", "--arm", "cdsm_lab", "--out", "found", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "found/report.html" in done.stdout
    folder = tmp_path / "found"
    assert {path.name for path in folder.iterdir()} == {"verdict.json", "arm.yaml", "report.html"}
    verdict = read_verdict(folder / "verdict.json")
    assert (verdict.recording, verdict.arm) == ("new", "cdsm_lab")
    assert verdict.effects == ("payload",)
    assert verdict.where.segments == ("segment_3",)
    assert verdict.parameters["payload.mass_kg"].value == pytest.approx(0.5, rel=0.06)
    # on loads and poses that the diagnosis never saw
    unseen = replace(PROBLEM, command_rad=-0.7 * PROBLEM.command_rad, load_n=0.6 * PROBLEM.load_n)
    real, after, before = (
        replay_arm(arm, unseen.time_s, unseen.command_rad, unseen.forces_n)
        for arm in (heavy, load_arm(folder / "arm.yaml"), LAB)
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
    return replace(recording, trial=0 * recording.trial)


@pytest.mark.parametrize(
    ("what", "says"),
    [
        ("time that stands still", "time_s"),
        ("degrees", "rad"),
        ("another arm", "give the arm file of this arm"),
        ("one trial", "2 trials"),
    ],
)
def test_a_recording_that_cannot_be_used_ends_with_2_and_one_line(tmp_path, what, says):
    write_csv(tmp_path / "new.csv", broken(recorded(LAB), what))
    done = run("diagnose", "new.csv", "--out", "found", cwd=tmp_path)
    assert done.returncode == 2
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("cablesense: ")
    assert says in line
    assert not (tmp_path / "found").exists()
