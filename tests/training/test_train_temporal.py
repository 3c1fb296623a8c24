"""From sequences to a model file that says what it is, by function and by command."""

import json

import pytest
from typer.testing import CliRunner

from cablesense_cli.app import app
from cablesense_sim.arm import open_arm
from cablesense_training.errors import TrainingError
from cablesense_training.fit_sequences import SequenceFitSettings
from cablesense_training.inference.temporal_estimator import TemporalEstimator
from cablesense_training.motion.motion_protocol import MotionProtocol
from cablesense_training.train_temporal import train_temporal, training_and_test

ARM = open_arm("cdsm_friction")
SETTINGS = SequenceFitSettings(epochs=1, batch_size=4, threads=1)


@pytest.fixture(scope="module")
def sequences():
    return training_and_test(ARM, MotionProtocol(sequences=8, duration_s=2.0), seed=3)


def test_the_file_says_what_it_was_made_for(sequences, tmp_path):
    training, test = sequences
    assert len(test) == 1
    path = tmp_path / "model.onnx"
    report = train_temporal(path, "temporal", training, test, SETTINGS, command="made by a test")
    estimator = TemporalEstimator.load(path, ARM)
    metadata = estimator.metadata
    assert (metadata.network, metadata.command) == ("temporal", "made by a test")
    assert (metadata.tick_s, metadata.joint_speed_deg_s) == (0.02, 20.0)
    assert metadata.memory > 0
    assert metadata.units["next_state"] == "1"
    assert report.figures.every.samples == test.segment.size
    assert path.stat().st_size < 2_000_000


def test_another_network_or_folder_is_refused_before_any_work(sequences, tmp_path):
    training, test = sequences
    with pytest.raises(TrainingError, match="there are: temporal, momentary"):
        train_temporal(tmp_path / "m.onnx", "two-stage", training, test, SETTINGS, command="")
    path = tmp_path / "no" / "m.onnx"
    with pytest.raises(TrainingError, match="no folder"):
        train_temporal(path, "temporal", training, test, SETTINGS, command="")


def test_the_verb_refuses_options_of_single_samples():
    result = CliRunner().invoke(app, ["train", "--network", "temporal", "--pose", "straight"])
    assert isinstance(result.exception, TrainingError) or result.exit_code == 2


def test_the_verb_trains_and_prints_figures(tmp_path):
    path = tmp_path / "momentary.onnx"
    options = ["--samples", "5", "--epochs", "1", "--threads", "1", "--out", str(path), "--json"]
    verb = ["train", "--network", "momentary", "--arm", "cdsm_friction"]
    result = CliRunner().invoke(app, [*verb, *options])
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    assert figures["sequences"] == 5
    assert 0.0 <= figures["every"]["contact_accuracy"] <= 1.0
    assert TemporalEstimator.load(path).metadata.command.startswith("cablesense train --arm")
