"""An arm of another shape, 5 segments with 4 cables each, goes all the way through the verbs."""

import json

import pytest
from arm_variants import five_by_four, five_by_four_text
from typer.testing import CliRunner

from cablesense_ros.cli.app import app
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.parquet import read_dataset
from cablesense_training.data.protocols import SingleContact
from cablesense_training.evaluation.metrics import (
    ContactTruth,
    noise_bound,
    single_contact_metrics,
)
from cablesense_training.inference.estimator import Estimator
from cablesense_training.model_training import build_network, contact_answer


def run(*arguments):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output + repr(result.exception)
    return result.stdout


@pytest.fixture(scope="module")
def arm_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "five_by_four.yaml"
    path.write_text(five_by_four_text(), encoding="utf-8")
    return path


@pytest.fixture(autouse=True)
def small_test_set(monkeypatch):
    monkeypatch.setattr("cablesense_training.model_training.TEST_SAMPLES", 300)
    monkeypatch.setattr("cablesense_online.misfit_limit.POSES", 1)


@pytest.mark.slow
def test_a_network_is_trained_on_its_dataset_and_evaluated(arm_file, tmp_path):
    data, model = tmp_path / "data.parquet", tmp_path / "model.onnx"
    run("dataset", "--arm", arm_file, "--samples", 600, "--pose", "random", "--out", data)
    dataset = read_dataset(data, five_by_four())
    assert dataset.tension_difference_n.shape == (600, 20)
    assert set(dataset.segment) == {0, 1, 2, 3, 4, 5}
    small = ["--threads", 1, "--epochs", 2, "--json", "--out", model, "--network", "two-stage"]
    report = json.loads(run("train", "--arm", arm_file, "--data", data, *small))
    assert report["network"] == "two-stage"
    assert len(report["single"]["confusion"]) == 6
    assert report["single"]["errors"].keys() >= {"direction_mae_deg", "magnitude_mae_n"}
    metadata = Estimator.load(model, five_by_four()).metadata
    assert metadata.arm.cable_count == 20
    assert metadata.command.startswith("cablesense train --arm ")
    assert metadata.command.endswith("--seed 0 --threads 1 --out model.onnx")
    found = json.loads(run("evaluate", "--model", model, "--samples", 300, "--json"))
    assert found["single"]["magnitude_mae_n"] > found["bound"]["magnitude_mae_n"]


def test_its_statics_find_contacts():
    protocol = SingleContact(samples=300, pose="random")
    dataset = draw_dataset(five_by_four(), protocol)
    network = build_network("closed-form-corrected", five_by_four())
    answer = contact_answer(network, dataset.tension_difference_n, dataset.command_rad)
    metrics = single_contact_metrics(ContactTruth.of(dataset), answer, 5)
    assert metrics.contact_accuracy > 0.98
    assert metrics.errors.magnitude_mae_n < 2.0 * noise_bound(dataset).magnitude_mae_n
