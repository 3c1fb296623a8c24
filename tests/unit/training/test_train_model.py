"""Networks are trained into model files, by recipes that callers can adjust."""

from dataclasses import asdict, replace

import pytest

from cablesense_contact.inference.estimator import Estimator
from cablesense_contact.inference.metadata import REMOVED_NETWORKS
from cablesense_sim.arm import open_arm
from cablesense_sim.load_capacity import contact_range_n
from cablesense_training.errors import TrainingError
from cablesense_training.evaluation.metrics import (
    ContactAnswer,
    ContactTruth,
    single_contact_metrics,
)
from cablesense_training.fit import FitSettings
from cablesense_training.model_training import (
    TEST_SEED_OFFSET,
    draw_training_data,
    recipe_for,
    train_model,
)
from tests.helpers.arm_variants import variant

pytestmark = pytest.mark.exports

ARM = open_arm("cdsm")
QUICK = FitSettings(epochs=2, batch_size=256, threads=1)
FEW = {"samples": 600, "pose": "random", "pose_range_deg": 5.0, "force_high_n": None}


@pytest.fixture(scope="module")
def single():
    return draw_training_data(ARM, "two-stage", FEW, seed=0)


def test_an_arm_that_bears_two_newtons_is_trained_on_two_newtons():
    forces = {"cables.stiffness_n_m": 1e3, "cables.pretension_n": 0.5, "segments.mass_kg": 0.005}
    sensors = {"sensors.noise_std_n": 1e-3, "sensors.step_n": 0.0}
    weak = variant({"segments.count": 2} | forces | sensors, "cdsm_lab")
    data = draw_training_data(weak, "two-stage", FEW, seed=0)
    assert data.protocol.force_high_n == contact_range_n(weak) < 10.0
    assert not data.redrawn.any()


@pytest.mark.slow
def test_the_model_file_answers_as_the_report_says(single, tmp_path):
    name = "two-stage"
    path = tmp_path / "model.onnx"
    report = train_model(path, name, single, QUICK, command="made so", test_samples=200)
    estimator = Estimator.load(path, ARM)
    assert estimator.metadata.command == "made so"
    assert estimator.metadata.pose_range_deg == 5.0
    assert estimator.metadata.network == name
    fresh = draw_training_data(ARM, name, {**FEW, "samples": 200}, seed=TEST_SEED_OFFSET)
    answers = estimator.estimate_batch(fresh.tension_difference_n)
    found = single_contact_metrics(
        ContactTruth.of(fresh), ContactAnswer.of(answers), ARM.segment_count
    )
    assert asdict(found).items() <= report.errors["single"].items()


def test_refuses_data_of_the_wrong_protocol(single, tmp_path):
    with pytest.raises(TrainingError, match="--protocol multi"):
        train_model(tmp_path / "m.onnx", "multi-contact", single, QUICK, command="")


@pytest.mark.parametrize("name", [*REMOVED_NETWORKS, "anywhere"])
def test_a_network_of_earlier_versions_names_what_makes_the_estimator_now(name):
    with pytest.raises(TrainingError, match=f"network {name} was .*cablesense export --arm"):
        recipe_for(name)


def test_refuses_a_folder_that_is_not_there_before_training(single, tmp_path):
    with pytest.raises(TrainingError, match="No such file or directory"):
        train_model(tmp_path / "gone" / "m.onnx", "two-stage", single, QUICK, command="")
    with pytest.raises(TrainingError, match="is a folder"):
        train_model(tmp_path, "two-stage", single, QUICK, command="")


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("epochs", 0),
        ("batch_size", -1),
        ("threads", 0),
        ("learning_rate", 0.0),
        ("learning_rate", float("nan")),
        ("learning_rate", 2.0),
    ],
)
def test_refuses_what_cannot_train(option, value):
    options = {"seed": 0, "threads": 1, option: value}
    with pytest.raises(TrainingError, match=option):
        replace(recipe_for("two-stage").settings, **options)
