"""`cablesense gap predict`: what sensors would have read, from commands and loads alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from typer.testing import CliRunner

from cablesense_base import CableSenseError
from cablesense_gap.amended_arm import amended_arm, write_arm
from cablesense_gap.simulator import Term
from cablesense_recording.csv_file import read_csv, write_csv
from cablesense_ros.cli.app import app
from cablesense_sim.replay import replay_arm
from tests.helpers.gap_recordings import LAB, small_recording

RECORDING = small_recording(peak_n=20.0).rows(slice(0, 80))
FOUND = {
    Term("payload", "segment_2", "mass_kg"): 0.4,
    Term("capstan_friction", "arm", "coefficient"): 0.05,
    Term("sensor_gain", "cable_3", "gain"): 0.05,
}


def run(*arguments):
    return CliRunner().invoke(app, ["gap", "predict", *map(str, arguments)])


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "new.csv"
    noise_n = np.random.default_rng(0).normal(0.0, 5.0, RECORDING.tensions_n.shape)
    write_csv(path, replace(RECORDING, tensions_n=RECORDING.tensions_n + noise_n))
    return path


def test_an_amended_file_predicts_what_was_never_diagnosed(recording, tmp_path):
    arm = tmp_path / "arm.yaml"
    out = tmp_path / "predicted.csv"
    amended = amended_arm(LAB, FOUND, {})
    write_arm(arm, amended, "made for this test")
    result = run(recording, "--arm", arm, "--out", out)
    assert result.exit_code == 0, result.output
    wanted = replay_arm(amended, RECORDING.course)
    assert_allclose(read_csv(out, LAB).tensions_n, wanted, atol=1e-3)


def test_the_folder_of_a_diagnosis_gives_its_amended_arm(recording, tmp_path):
    folder = tmp_path / "found"
    named = tmp_path / "named.csv"
    out = tmp_path / "predicted.csv"
    folder.mkdir()
    strange = run(recording, "--arm", folder, "--out", out).exception
    assert "found: has no amended_arm.yaml; give the folder" in str(strange)
    write_arm(folder / "amended_arm.yaml", amended_arm(LAB, FOUND, {}), "made for this test")
    for arm, path in ((folder, out), (folder / "amended_arm.yaml", named)):
        result = run(recording, "--arm", arm, "--out", path)
        assert result.exit_code == 0, result.output
    assert out.read_text() == named.read_text()


@pytest.mark.parametrize(
    ("arm", "out", "text"),
    [
        ("cdsm_table2", "p.csv", "tension_1_n … tension_9_n"),
        ("nonsense", "p.csv", "bundled arms are"),
        ("cdsm_lab", "no/such/p.csv", "cannot be written"),
    ],
)
def test_what_cannot_be_is_one_line(recording, tmp_path, arm, out, text):
    result = run(recording, "--arm", arm, "--out", tmp_path / out)
    assert isinstance(result.exception, CableSenseError)
    assert text in str(result.exception)
    assert "\n" not in str(result.exception)
    assert not (tmp_path / out).exists()


def test_the_state_is_settled_on_the_first_rows_and_never_on_all(recording, tmp_path):
    arm = tmp_path / "arm.yaml"
    out = tmp_path / "predicted.csv"
    play = {
        Term("actuator_backlash", "cable_5", "play_m"): 2e-4,
        Term("actuator_backlash", "cable_5", "start"): 1.0,
    }
    write_arm(arm, amended_arm(LAB, play, {}), "made for this test")
    result = run(recording, "--arm", arm, "--out", out, "--settle", 20)
    assert result.exit_code == 0, result.output
    assert "Not counted: the first 20" in result.output.replace("\n", " ")
    refused = run(recording, "--arm", arm, "--out", out, "--force", "--settle", 80)
    assert "--settle 80" in str(refused.exception)
