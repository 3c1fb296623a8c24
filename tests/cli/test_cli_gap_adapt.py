"""`cablesense gap adapt`: its folder, its words where the first model is kept, its refusals."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_recordings import LAB, small_recording
from html_page import draw_no_pictures
from verdict_cases import verdict_of

from cablesense_gap import adaptation
from cablesense_gap.arm_system import Diagnosis
from cablesense_gap.recordings.csv_file import write_csv
from cablesense_gap.verdict import Share
from cablesense_sim.arm import find_arm
from cablesense_sim.replay import replay_arm
from cablesense_training.inference.metadata import find_model

PROTOCOL = small_recording()
SHARE = Share(share_n=1.0, ci95_n=(0.9, 1.1), left_n=0.1, probability=1.0)


@pytest.fixture
def recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A healthy arm's recording, diagnosed as having a payload; training gives the same model."""

    def diagnose(recording, arm, *_, force=False) -> Diagnosis:
        rest = {"tolerances_n": 0.1, "unexplained_n": 0.0, "unexplained_share": 0.0}
        verdict = verdict_of("payload", shares={"payload": SHARE}, **rest)
        read = recording.tensions_n
        every = np.ones(len(recording), dtype=bool)
        return Diagnosis(recording, arm, verdict, LAB, read, read, every)

    def train(arm, first, recording, unseen, path, *_) -> None:
        shutil.copy(find_model("cdsm_lab"), path)

    draw_no_pictures(monkeypatch)
    monkeypatch.setattr(adaptation, "diagnose", diagnose)
    monkeypatch.setattr(adaptation, "train_for", train)
    true_n = replay_arm(LAB, *PROTOCOL.inputs)
    write_csv(tmp_path / "new.csv", replace(PROTOCOL, tensions_n=true_n))
    return "new.csv"


def test_a_second_model_that_is_no_better_is_not_left_behind(command, recorded, tmp_path):
    (tmp_path / "adapted").mkdir()
    (tmp_path / "adapted" / "estimator.onnx").write_text("of an earlier run")
    done = command("gap", "adapt", recorded, "--out", "adapted", "--force", "--json")
    assert done.returncode == 0
    said = json.loads(done.stdout)
    assert (said["better"], said["model"]) == (False, str(find_model("cdsm_lab_anywhere")))
    assert not (tmp_path / "adapted" / "estimator.onnx").exists()
    assert "keep the first" in (tmp_path / "adapted" / "report.html").read_text()


def test_an_arm_without_a_model_is_told_how_to_get_one(command, recorded, tmp_path):
    lab = find_arm("cdsm_lab").read_text()
    (tmp_path / "mine.yaml").write_text(lab.replace("name: cdsm_lab", "name: mine"))
    done = command("gap", "adapt", recorded, "--arm", "mine.yaml", "--out", "adapted")
    assert done.returncode == 2
    assert "cablesense train --arm mine.yaml --out mine.onnx" in done.stderr
    assert not (tmp_path / "adapted").exists()
