"""An arm of another shape, 5 segments with 4 cables each, goes all the way through the verbs."""

import json

import pytest
from typer.testing import CliRunner

from cablesense_contact.inference.estimator import Estimator
from cablesense_contact.inference.law_model import LawModel
from cablesense_ros.cli.app import app
from cablesense_sim.build import mechanism_of
from cablesense_sim.uncertain_arm import arm_parameters
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.parquet import read_dataset
from cablesense_training.data.protocols import SingleContact
from cablesense_training.evaluation.law import exact_calibration
from cablesense_training.evaluation.metrics import (
    ContactTruth,
    noise_bound,
    single_contact_metrics,
)
from cablesense_training.evaluation.points import point_answer
from cablesense_training.law.build import TorchLaw
from tests.helpers.arm_variants import five_by_four, five_by_four_text

pytestmark = pytest.mark.exports


def run(*arguments):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output + repr(result.exception)
    return result.stdout


@pytest.fixture(scope="module")
def arm_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "five_by_four.yaml"
    path.write_text(five_by_four_text("cdsm_lab"), encoding="utf-8")
    return path


@pytest.fixture(autouse=True)
def small_test_set(monkeypatch):
    monkeypatch.setattr("cablesense_training.model_training.TEST_SAMPLES", 300)


@pytest.mark.slow
def test_a_network_is_trained_on_its_dataset_and_evaluated(arm_file, tmp_path):
    data = tmp_path / "data.parquet"
    model = tmp_path / "model.onnx"
    run("dataset", "--arm", arm_file, "--samples", 600, "--pose", "random", "--out", data)
    dataset = read_dataset(data, five_by_four("cdsm_lab"))
    assert dataset.tension_difference_n.shape == (600, 20)
    assert set(dataset.segment) == {0, 1, 2, 3, 4, 5}
    small = ["--threads", 1, "--epochs", 2, "--json", "--out", model, "--network", "two-stage"]
    report = json.loads(run("train", "--arm", arm_file, "--data", data, *small))
    assert report["network"] == "two-stage"
    assert len(report["single"]["confusion"]) == 6
    assert report["single"]["errors"].keys() >= {"direction_mae_deg", "magnitude_mae_n"}
    metadata = Estimator.load(model, five_by_four("cdsm_lab")).metadata
    assert metadata.arm.cable_count == 20
    assert metadata.command.startswith("cablesense train --arm ")
    assert metadata.command.endswith("--seed 0 --threads 1 --out model.onnx")
    figures = json.loads(run("evaluate", "--model", model, "--samples", 300, "--json"))
    assert figures["single"]["magnitude_mae_n"] > figures["bound"]["magnitude_mae_n"]


def test_its_law_finds_contacts_at_the_noise_bound():
    protocol = SingleContact(samples=300, pose="random")
    arm = five_by_four("cdsm_lab")
    dataset = draw_dataset(arm, protocol)
    answer = point_answer(
        TorchLaw(arm),
        exact_calibration(arm),
        dataset.unloaded_n + dataset.tension_difference_n,
        dataset.command_rad,
        mechanism_of(arm).contact_m,
        protocol.force_high_n,
    )
    metrics = single_contact_metrics(ContactTruth.of(dataset), answer, 5)
    assert metrics.contact_accuracy > 0.98
    assert metrics.errors.magnitude_mae_n < 2.0 * noise_bound(dataset).magnitude_mae_n


@pytest.mark.slow
def test_its_estimator_is_exported_and_evaluated_on_arms_built_by_its_file(arm_file, tmp_path):
    model = tmp_path / "five_by_four.onnx"
    report = json.loads(run("export", "--arm", arm_file, "--out", model, "--json"))
    assert report["out"] == str(model)
    assert report["bytes"] == model.stat().st_size
    assert report["parameters"] == len(arm_parameters(five_by_four("cdsm_lab")))
    assert LawModel(model, five_by_four("cdsm_lab")).metadata.command.startswith(
        "cablesense export --arm "
    )
    content = json.loads(
        run("evaluate", "--model", model, "--samples", 200, "--seed", 1, "--json")
    )
    assert set(content) == {"force_range_n", "built_by_tolerances", "as_the_file"}
    for name in ("built_by_tolerances", "as_the_file"):
        touched = content[name]["touched"]
        assert list(touched) == ["all", *(f"segment_{n}" for n in range(1, 6))]
        assert touched["all"]["answered"] > 0.9
        assert touched["all"]["force_coverage95"] > 0.85
        assert content[name]["false_contacts"] == 0
    assert content["built_by_tolerances"]["arms"] == 2
