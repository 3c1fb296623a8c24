"""`cablesense evaluate`: tables for people, JSON for programs, one line for what cannot be."""

import json
from dataclasses import replace

import numpy as np
import pytest
from gap_recordings import LAB, small_recording
from typer.testing import CliRunner

from cablesense_gap.recordings.csv_file import write_csv
from cablesense_ros.cli.app import app
from cablesense_sim.arm import open_arm
from cablesense_sim.replay import read_tensions_n, replay_arm
from cablesense_training.evaluation.comparison import SHIPPED, TABLE2_MODELS
from cablesense_training.inference.metadata import find_model


def _run(*arguments):
    result = CliRunner().invoke(app, ["evaluate", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    return result.stdout


def test_table2_as_json_has_six_rows_of_true_and_estimated():
    model = find_model(TABLE2_MODELS[SHIPPED])
    content = json.loads(_run("--table2", "--model", model, "--json"))
    assert content["model"]
    assert len(content["rows"]) == 6
    for row in content["rows"]:
        assert row["true_segment"] == row["segment"]
        assert row["true_angle_deg"] == 180.0
        assert row["angle_deg"] == pytest.approx(180.0, abs=2.0)
        assert row["true_magnitude_n"] in (9.81, 19.62)
        assert row["magnitude_n"] == pytest.approx(row["true_magnitude_n"], rel=0.1)
        error = row["magnitude_n"] / row["true_magnitude_n"] - 1.0
        assert row["magnitude_error"] == pytest.approx(error)


@pytest.mark.slow
def test_one_model_is_evaluated_on_its_own_arm():
    path = find_model("cdsm")
    content = json.loads(_run("--model", path, "--samples", 200, "--seed", 1, "--json"))
    assert set(content) == {"single", "bound"}
    assert content["single"]["contact_accuracy"] > 0.97
    assert content["bound"]["contacts"] == pytest.approx(160, abs=2)
    error, bound = content["single"]["magnitude_mae_n"], content["bound"]["magnitude_mae_n"]
    assert 0.7 * bound < error < 2.0 * bound
    again = json.loads(_run("--model", path, "--samples", 200, "--seed", 1, "--json"))
    assert again == content
    assert "closed-form-corrected" in _run("--model", path, "--samples", 200)


@pytest.mark.slow
def test_a_model_of_contacts_anywhere_is_evaluated_beside_a_profile():
    content = json.loads(_run("--model", "cdsm_anywhere", "--samples", 100, "--json"))
    assert set(content) == {"anywhere", "commanded_profile"}


def test_a_recording_is_judged_by_segment_and_force_with_several_models(tmp_path):
    recorded = small_recording()
    true_n = replay_arm(LAB, *recorded.inputs)
    file, picture = tmp_path / "loads.csv", tmp_path / "errors.png"
    write_csv(file, replace(recorded, tensions_n=true_n))
    models = ("--model", "cdsm_lab", "--model", "peers/cdsm_lab_closed_form")
    content = json.loads(_run("--recording", file, *models, "--json"))
    assert list(content) == list(models[1::2])
    shown = _run("--recording", file, *models[:2], "--picture", picture)
    assert "by_segment" in shown
    assert "false_force_n" in shown
    assert picture.exists()


@pytest.mark.slow  # ONNX Runtime steps through a whole recording
def test_a_model_with_memory_is_judged_along_the_recording_and_one_of_several_contacts_is_refused(
    tmp_path,
):
    recorded, arm = small_recording(), open_arm("cdsm")
    ideal_n = replay_arm(arm, *recorded.inputs)
    read_n = read_tensions_n(ideal_n, arm.sensors, np.random.default_rng(0))
    write_csv(tmp_path / "loads.csv", replace(recorded, tensions_n=read_n))
    arguments = ("--recording", tmp_path / "loads.csv", "--model")
    whole = json.loads(_run(*arguments, "cdsm_moving", "--json"))["cdsm_moving"]["all"]
    assert whole["contact_accuracy"] == 1.0
    assert whole["errors"]["magnitude_mae_n"] < 0.2
    refused = CliRunner().invoke(app, ["evaluate", *map(str, arguments), "cdsm_multi"])
    assert "multi-contact" in str(refused.exception)
