"""`cablesense train` as a user meets it; tests/packaging/test_tutorial.py has a whole training."""

import json

import pytest
import typer
from typer.testing import CliRunner

from cablesense_ros.cli.options import command_line
from cablesense_ros.cli.train import train
from cablesense_training.errors import TrainingError
from cablesense_training.inference.estimator import Estimator

app = typer.Typer(pretty_exceptions_enable=False)
app.command()(train)
SMALL = ["--network", "two-stage", "--samples", "400", "--epochs", "2", "--threads", "1"]


@pytest.fixture(autouse=True)
def small_test_set(monkeypatch):
    monkeypatch.setattr("cablesense_training.model_training.TEST_SAMPLES", 300)


def _run(*words):
    return CliRunner().invoke(app, list(words), env={"COLUMNS": "200"})


@pytest.mark.slow  # exports a model
def test_json_holds_the_figures_and_nothing_else(tmp_path, monkeypatch):
    monkeypatch.setattr("cablesense_online.misfit_limit.put_simulated_limit", lambda path: None)
    drawn = ("--randomise", "payload,sensor_gain")
    result = _run(*SMALL, *drawn, "--json", "--out", str(tmp_path / "model.onnx"))
    figures = json.loads(result.stdout)
    command = Estimator.load(tmp_path / "model.onnx").metadata.command
    assert command.startswith("cablesense train --arm cdsm --network two-stage --samples 400")
    assert " ".join(drawn) in command
    assert command.endswith("--seed 0 --threads 1 --out model.onnx")
    assert figures["network"] == "two-stage"
    assert 0.0 <= figures["single"]["contact_accuracy"] <= 1.0
    assert figures["single"]["errors"].keys() >= {"direction_mae_deg", "magnitude_mae_n"}


def test_nothing_is_written_when_a_network_is_unknown(tmp_path):
    result = _run("--network", "magic", "--out", str(tmp_path / "model.onnx"))
    assert isinstance(result.exception, TrainingError)
    assert "two-stage" in str(result.exception)
    assert not list(tmp_path.iterdir())


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
