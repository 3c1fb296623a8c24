"""`cablesense train` as a user meets it."""

import json

import pytest
import typer
import yaml
from arm_variants import variant
from typer.testing import CliRunner

from cablesense_ros.cli.options import command_line
from cablesense_ros.cli.train import train
from cablesense_training.errors import TrainingError
from cablesense_training.inference.estimator import Estimator
from cablesense_training.recipes import RECIPES

app = typer.Typer(pretty_exceptions_enable=False)
app.command()(train)
SMALL = ["--network", "two-stage", "--samples", "400", "--epochs", "2", "--threads", "1"]


@pytest.fixture(autouse=True)
def small_test_set(monkeypatch):
    monkeypatch.setattr("cablesense_training.model_training.TEST_SAMPLES", 300)
    monkeypatch.setattr("cablesense_online.misfit_limit.POSES", 1)


def _run(*words):
    return CliRunner().invoke(app, list(words), env={"COLUMNS": "200"})


@pytest.mark.slow
def test_writes_a_model_and_prints_its_figures(tmp_path):
    out = tmp_path / "model.onnx"
    result = _run(*SMALL, "--out", str(out))
    assert result.exit_code == 0, result.output
    assert Estimator.load(out).metadata.misfit_limit.samples
    for words in ("contact", "direction MAE", "force MAE", "by force", "100 to 200 N"):
        assert words in result.output


def test_json_holds_the_figures_and_nothing_else(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "cablesense_training.model_training.export_model",
        lambda network, path, metadata: path.write_bytes(metadata.command.encode()),
    )
    monkeypatch.setattr("cablesense_online.misfit_limit.put_simulated_limit", lambda path: None)
    result = _run(*SMALL, "--json", "--out", str(tmp_path / "model.onnx"))
    figures = json.loads(result.stdout)
    command = (tmp_path / "model.onnx").read_text()
    assert command.startswith("cablesense train --arm cdsm --network two-stage --samples 400")
    assert command.endswith("--seed 0 --threads 1 --out model.onnx")
    assert figures["network"] == "two-stage"
    assert 0.0 <= figures["single"]["contact_accuracy"] <= 1.0


def test_nothing_is_written_when_a_network_is_unknown(tmp_path):
    result = _run("--network", "magic", "--out", str(tmp_path / "model.onnx"))
    assert isinstance(result.exception, TrainingError)
    assert "two-stage" in str(result.exception)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_an_amended_arm_is_trained_for_as_any_other(tmp_path):
    listed = [
        {"effect": "payload", "at": "segment_4", "parameters": {"mass_kg": 0.3}},
        {
            "effect": "routing_geometry",
            "at": "segment_2",
            "parameters": {"plates_angle_rad": 0.02},
        },
        {"effect": "sensor_gain", "at": "cable_3", "parameters": {"gain": 0.04}},
    ]
    path, out = tmp_path / "amended.yaml", tmp_path / "model.onnx"
    arm = variant({"effects": listed}, "cdsm_lab")
    path.write_text(yaml.safe_dump(arm.model_dump()), encoding="utf-8")
    result = _run(*SMALL, "--arm", str(path), "--out", str(out))
    assert result.exit_code == 0, result.output
    assert Estimator.load(out, arm).metadata.arm_identity == arm.identity


@pytest.mark.slow
def test_samples_on_arms_drawn_at_random_stand_in_the_command(tmp_path):
    out = tmp_path / "model.onnx"
    result = _run(*SMALL, "--randomise", "payload,sensor_gain", "--json", "--out", str(out))
    assert result.exit_code == 0, result.output
    assert "--randomise payload,sensor_gain" in Estimator.load(out).metadata.command


def test_the_command_names_what_was_chosen_and_quotes_it():
    options = {"arm": "my arm.yaml", "samples": 5, "data": None, "pose_range_deg": 10.0}
    assert command_line("train", options) == (
        "cablesense train --arm 'my arm.yaml' --samples 5 --pose-range-deg 10.0"
    )


def test_a_network_for_sequences_draws_them_itself(tmp_path, monkeypatch):
    asked = {}

    def train_nothing(path, network, data, settings, *, command, **_):
        asked.update(data, network=network, epochs=settings.epochs, command=command)
        raise TrainingError("enough")

    module = "cablesense_training.model_training"
    monkeypatch.setattr(f"{module}.draw_training_data", lambda arm, name, given, *_, **__: given)
    monkeypatch.setattr(f"{module}.train_model", train_nothing)
    words = ["--network", "temporal", "--samples", "4", "--epochs", "1", "--force-high-n", "50"]
    result = _run(*words, "--out", str(tmp_path / "model.onnx"))
    assert str(result.exception) == "enough"
    assert (asked["samples"], asked["force_high_n"], asked["epochs"]) == (4, 50.0, 1)
    assert "--network temporal --samples 4" in asked["command"]


def test_help_lists_every_network():
    shown = " ".join(_run("--help").output.split())
    for name in RECIPES:
        assert name in shown.replace("- ", "-"), name
