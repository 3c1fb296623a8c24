"""`cablesense evaluate`: tables for people, JSON for programs, one line for what cannot be."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from cablesense_contact.calibration import Calibrator
from cablesense_contact.calibration_file import write_calibration
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.inference.law_model import LawModel
from cablesense_contact.inference.metadata import find_model
from cablesense_recording.csv_file import write_csv
from cablesense_ros.cli.app import app
from cablesense_sim.replay import read_tensions_n, replay_arm
from cablesense_training.evaluation.comparison import SHIPPED, TABLE2_MODELS, TWO_STAGE
from tests.helpers.gap_recordings import LAB, small_recording


def _run(*arguments):
    result = CliRunner().invoke(app, ["evaluate", *map(str, arguments)])
    assert result.exit_code == 0, result.output + repr(result.exception)
    return result.stdout


def assert_short(shown):
    """Some six figures below each other, in a terminal of 80 columns, and the way to the rest."""
    lines = shown.splitlines()
    assert len(lines) <= 9
    assert max(map(len, lines)) <= 80
    assert lines[-1] == "all figures: --verbose or --json"


def test_the_loads_of_the_paper_fit_a_terminal():
    shown = _run("--table2")
    assert_short(shown)
    assert "10.08 N (+2.8%)" in shown


@pytest.mark.slow
def test_the_estimator_is_compared_with_the_networks_in_some_lines():
    assert_short(_run("--samples", 100))


@pytest.mark.parametrize(("name", "within"), [(SHIPPED, 0.1), (TWO_STAGE, 0.15)])
def test_table2_as_json_has_six_rows_of_true_and_estimated(name, within):
    content = json.loads(_run("--table2", "--model", TABLE2_MODELS[name], "--json"))
    assert content["model"]
    assert len(content["rows"]) == 6
    for row in content["rows"]:
        assert row["true_segment"] == row["segment"]
        assert row["true_angle_deg"] == 180.0
        assert row["angle_deg"] == pytest.approx(180.0, abs=3.0)
        assert row["true_magnitude_n"] in (9.81, 19.62)
        assert row["magnitude_n"] == pytest.approx(row["true_magnitude_n"], rel=within)
        error = row["magnitude_n"] / row["true_magnitude_n"] - 1.0
        assert row["magnitude_error"] == pytest.approx(error)
        low_n, high_n = row["magnitude_ci95_n"]
        assert low_n < row["magnitude_n"] < high_n


@pytest.mark.slow
def test_a_network_is_evaluated_on_its_own_arm_beside_the_bound():
    model = "peers/cdsm_straight_two_stage"
    arguments = ("--model", model, "--samples", 200, "--seed", 1, "--json")
    content = json.loads(_run(*arguments))
    assert set(content) == {"single", "bound"}
    assert content["single"]["contact_accuracy"] > 0.95
    assert content["bound"]["contacts"] == pytest.approx(160, abs=2)
    assert content["single"]["magnitude_mae_n"] > content["bound"]["magnitude_mae_n"]
    assert json.loads(_run(*arguments)) == content
    shown = _run("--model", model, "--samples", 200)
    assert "two-stage" in shown
    assert_short(shown)


@pytest.mark.slow
def test_the_law_is_evaluated_on_built_arms_and_on_that_of_its_file():
    content = json.loads(_run("--model", "cdsm_lab_anywhere", "--samples", 100, "--json"))
    assert set(content) == {"force_range_n", "built_by_tolerances", "as_the_file"}
    assert content["force_range_n"] == [5.0, 40.0]
    assert content["built_by_tolerances"]["arms"] == 1
    shown = _run("--model", "cdsm_lab_anywhere", "--samples", 100)
    assert_short(shown)
    every_figure = _run("--model", "cdsm_lab_anywhere", "--samples", 100, "--verbose")
    assert every_figure.startswith(shown.rpartition("all figures")[0])
    assert "built by tolerances" in every_figure


@pytest.mark.slow
def test_a_recording_is_judged_by_segment_and_force_with_several_models(tmp_path):
    recorded = small_recording()
    true_n = replay_arm(LAB, recorded.course)
    read_n = read_tensions_n(true_n, LAB.sensors, np.random.default_rng(0))
    file = tmp_path / "loads.csv"
    picture = tmp_path / "errors.png"
    write_csv(file, replace(recorded, tensions_n=read_n))
    model = find_model("cdsm_lab_anywhere")
    content = json.loads(
        _run("--recording", file, "--model", "cdsm_lab_anywhere", "--model", model, "--json")
    )
    assert list(content) == ["cdsm_lab_anywhere", str(model)]
    law = LawModel(model)
    calibration = tmp_path / "arm.calibration"
    write_calibration(calibration, Calibrator(FeltArm(law.arm), law).by_tolerances())
    shown = _run(
        "--recording", file, "--model", model, "--calibration", calibration, "--picture", picture
    )
    assert "segment 4" in shown
    assert "95 % intervals" in shown
    assert picture.exists()
    tolerances = law.arm.tolerances.model_copy(update={"pretension_n": 3.0})
    looser = law.arm.model_copy(update={"tolerances": tolerances})
    write_calibration(calibration, Calibrator(FeltArm(looser), law).by_tolerances())
    options = ["--recording", file, "--model", model, "--calibration", calibration]
    evaluation = CliRunner().invoke(app, ["evaluate", *map(str, options)])
    assert "made with other tolerances" in " ".join(evaluation.output.split())


def test_a_network_of_several_contacts_is_refused(tmp_path):
    refused = CliRunner().invoke(app, ["evaluate", "--model", "peers/cdsm_multi_two_stage"])
    assert "multi-contact" in str(refused.exception)
