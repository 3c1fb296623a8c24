"""`cablesense gap adapt`: its folder, its words where the first model is kept, its refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cablesense_contact.calibration_file import read_calibration
from cablesense_contact.felt_arm import FeltArm
from cablesense_gap import adaptation
from cablesense_gap.arm_system import Diagnosis
from cablesense_gap.verdict import Share
from cablesense_recording.csv_file import write_csv
from cablesense_sim.arm import ListedEffect, load_arm
from cablesense_sim.replay import replay_arm
from cablesense_training.errors import TrainingError
from tests.helpers.expected_parameters import expected_parameters
from tests.helpers.gap_recordings import LAB, small_recording
from tests.helpers.html_page import draw_no_pictures
from tests.helpers.verdict_cases import verdict_of

PROTOCOL = small_recording(peak_n=25.0).rows(np.r_[0:128])
SHARE = Share(share_n=1.0, ci95_n=(0.9, 1.1), left_n=0.1, probability=1.0)
GAIN = ListedEffect(effect="sensor_gain", at="cable_1", parameters={"gain": 0.3})


@pytest.fixture
def record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Writes the recording of an arm, which is always diagnosed as having a wrong gain."""

    def diagnose(recording, arm, *_, force=False, announce=None, kept=None) -> Diagnosis:
        rest = {"tolerances_n": 0.1, "unexplained_n": 0.0, "unexplained_share": 0.0}
        verdict = verdict_of("sensor_gain", shares={"sensor_gain": SHARE}, **rest)
        read = recording.tensions_n
        every = np.ones(len(recording), dtype=bool)
        amended = arm.model_copy(update={"effects": [GAIN]})
        known = expected_parameters(amended)
        return Diagnosis(recording, arm, verdict, amended, read, read, every, known)

    def export(arm, path, command, unexplained_n2) -> None:
        path.write_text(f"{arm.identity} by {command}")

    draw_no_pictures(monkeypatch)
    monkeypatch.setattr(adaptation, "diagnose", diagnose)
    monkeypatch.setattr(adaptation, "export_law", export)

    def write(*effects: ListedEffect) -> str:
        true_n = replay_arm(LAB.model_copy(update={"effects": list(effects)}), PROTOCOL.course)
        write_csv(tmp_path / "new.csv", replace(PROTOCOL, tensions_n=true_n))
        return "new.csv"

    return write


@pytest.mark.slow
def test_a_better_estimator_is_written_with_its_calibration(command, record, tmp_path):
    recording = record(GAIN)
    done = command("gap", "adapt", recording, "--out", "adapted", "--json")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["better"]
    assert said["model"] == "adapted/estimator.onnx"
    assert said["calibration"] == "adapted/calibration.npz"
    errors = said["verdict"]["estimator"]
    assert errors["use"] == "after"
    assert errors["after"]["force_mae_n"] < 0.5 * errors["before"]["force_mae_n"]
    arm = load_arm(tmp_path / "adapted" / "amended_arm.yaml")
    made_by = f"{arm.identity} by cablesense gap adapt new.csv --arm cdsm_lab --out adapted"
    assert (tmp_path / "adapted" / "estimator.onnx").read_text() == made_by
    calibration = read_calibration(tmp_path / "adapted" / "calibration.npz", FeltArm(arm))
    assert calibration.made_from == "the diagnosis of new"


@pytest.mark.slow
def test_people_read_how_to_run_it(command, record, tmp_path):
    done = command("gap", "adapt", record(GAIN), "--out", "adapted")
    assert "trials that the diagnosis did not have" in done.stdout
    assert "Use the new estimator." in done.stdout
    run = (
        "Next: use the new estimator: ros2 run cablesense_ros estimator --ros-args "
        "-p arm:=adapted/amended_arm.yaml "
        "-p model:=adapted/estimator.onnx -p calibration_file:=adapted/calibration.npz"
    )
    assert run in done.stdout
    assert run.partition("estimator: ")[2] in (tmp_path / "adapted" / "report.html").read_text()


@pytest.mark.slow
def test_a_second_model_that_is_no_better_is_kept_and_not_recommended(command, record, tmp_path):
    (tmp_path / "adapted").mkdir()
    for name in ("estimator.onnx", "calibration.npz"):
        (tmp_path / "adapted" / name).write_text("of an earlier run")
    recording = record()
    done = command("gap", "adapt", recording, "--out", "adapted", "--force", "--json")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert (said["better"], said["model"], said["calibration"]) == (False, None, None)
    assert said["made"] == "adapted/estimator.onnx"
    for name in ("estimator.onnx", "calibration.npz"):
        assert (tmp_path / "adapted" / name).read_bytes() != b"of an earlier run"
    report = (tmp_path / "adapted" / "report.html").read_text()
    assert "keep the first" in report
    assert "force stated wrongly" in report


@pytest.mark.slow
def test_a_new_estimator_that_does_not_hold_leaves_the_verdict(
    command, record, tmp_path, monkeypatch
):
    def refuse(arm, path, command, unexplained_n2) -> None:
        raise TrainingError("the estimator does not hold")

    monkeypatch.setattr(adaptation, "export_law", refuse)
    done = command("gap", "adapt", record(GAIN), "--out", "adapted")
    assert done.returncode == 0, done.stderr
    assert "No new estimator: the estimator does not hold" in done.stdout
    assert "-p arm:=cdsm_lab" in done.stdout
    assert not (tmp_path / "adapted" / "estimator.onnx").exists()
    assert (tmp_path / "adapted" / "verdict.json").exists()


def test_a_model_that_is_none_is_refused_before_the_diagnosis(command, record, tmp_path):
    (tmp_path / "mine.onnx").write_text("no model")
    options = ("--model", "mine.onnx", "--out", "adapted")
    done = command("gap", "adapt", record(), *options)
    assert done.returncode == 2
    assert "mine.onnx" in done.stderr
    assert not (tmp_path / "adapted").exists()
