"""Networks are trained into model files, by recipes that callers can adjust."""

import pytest
from arm_variants import variant

from cablesense_sim.arm import open_arm
from cablesense_sim.load_capacity import contact_range_n
from cablesense_training.data.motion_protocol import MotionProtocol
from cablesense_training.data.sequences import draw_sequences
from cablesense_training.errors import TrainingError
from cablesense_training.evaluation.metrics import (
    ContactAnswer,
    ContactTruth,
    single_contact_metrics,
)
from cablesense_training.fit import FitSettings
from cablesense_training.fit_sequences import SequenceFitSettings
from cablesense_training.inference.estimator import Estimator, MultiEstimator
from cablesense_training.inference.temporal_estimator import TemporalEstimator
from cablesense_training.model_training import (
    TEST_SEED_OFFSET,
    draw_training_data,
    train_model,
)
from cablesense_training.recipes import adjusted, recipe_for

ARM = open_arm("cdsm")
QUICK = FitSettings(epochs=2, batch_size=256, threads=1)
FEW = {"samples": 600, "pose": "random", "pose_range_deg": 5.0, "force_high_n": None}


@pytest.fixture(scope="module")
def single():
    return draw_training_data(ARM, "two-stage", FEW, seed=0)


@pytest.mark.slow  # a symbolic export
def test_an_arm_that_bears_two_newtons_is_trained_on_two_newtons(tmp_path):
    forces = {"cables.stiffness_n_m": 1e3, "cables.pretension_n": 0.5, "segments.mass_kg": 0.005}
    sensors = {"sensors.noise_std_n": 1e-3, "sensors.step_n": 0.0}
    weak = variant({"segments.count": 2} | forces | sensors, "cdsm_lab")
    name = "closed-form-corrected"
    data = draw_training_data(weak, name, FEW, seed=0)
    assert data.protocol.force_high_n == contact_range_n(weak) < 10.0
    assert not data.redrawn.any()
    path = tmp_path / "model.onnx"
    settings = adjusted(recipe_for(name).settings, epochs=1, threads=1)
    report = train_model(path, name, data, settings, command="", test_samples=200)
    assert report.single.contact_accuracy > 0.9


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
        ContactTruth.of(fresh),
        ContactAnswer(
            answers.segment,
            answers.angle_deg,
            answers.magnitude_n,
            answers.magnitude_std_n,
            answers.angle_std_deg,
        ),
        ARM.segment_count,
    )
    assert report.single is not None
    assert found.confusion == report.single.confusion
    assert found.errors.magnitude_mae_n == pytest.approx(report.single.errors.magnitude_mae_n)
    assert found.errors.direction_mae_deg == pytest.approx(report.single.errors.direction_mae_deg)


@pytest.mark.slow
def test_a_multi_contact_model_opens_and_answers(tmp_path):
    dataset = draw_training_data(ARM, "multi-contact", {"samples": 400}, seed=0)
    path = tmp_path / "model.onnx"
    report = train_model(path, "multi-contact", dataset, QUICK, command="", test_samples=200)
    figures = report.as_json()
    assert figures["multi"]["judged"] == 800
    assert figures["multi_firm"]["judged"] <= 800
    assert "single" not in figures
    answers = MultiEstimator.load(path, ARM).estimate_batch(dataset.tension_difference_n[:9])
    assert answers.magnitude_n.shape == (9, 4)


@pytest.mark.slow  # the export of the graph
def test_a_model_for_sequences_opens_and_names_what_it_was_made_for(tmp_path):
    sequences = draw_sequences(ARM, MotionProtocol(sequences=4, duration_s=0.5), seed=3)
    settings = SequenceFitSettings(epochs=1, batch_size=4, threads=1)
    path = tmp_path / "model.onnx"
    report = train_model(path, "temporal", sequences, settings, command="made so", test_samples=1)
    metadata = TemporalEstimator.load(path, ARM).metadata
    assert (metadata.network, metadata.command) == ("temporal", "made so")
    assert (metadata.tick_s, metadata.joint_speed_deg_s) == (0.02, 20.0)
    assert metadata.memory > 0
    assert metadata.units["next_state"] == "1"
    figures = report.as_json()
    assert (figures["sequences"], figures["test_sequences"]) == (4, 1)
    assert figures["every"]["samples"] == sequences.segment.shape[1]
    assert path.stat().st_size < 2_000_000


def test_settings_of_another_kind_of_network_are_refused(single, tmp_path):
    with pytest.raises(TrainingError, match="trained with FitSettings, not SequenceFitSettings"):
        train_model(tmp_path / "m.onnx", "two-stage", single, SequenceFitSettings(), command="")


def test_refuses_data_of_the_wrong_protocol(single, tmp_path):
    with pytest.raises(TrainingError, match="--protocol multi"):
        train_model(tmp_path / "m.onnx", "multi-contact", single, QUICK, command="")
    with pytest.raises(TrainingError, match="network temporal is for protocol motion"):
        train_model(tmp_path / "m.onnx", "temporal", single, QUICK, command="")


def test_refuses_a_folder_that_is_not_there_before_training(single, tmp_path):
    with pytest.raises(TrainingError, match="No such file or directory"):
        train_model(tmp_path / "gone" / "m.onnx", "two-stage", single, QUICK, command="")
    with pytest.raises(TrainingError, match="is a folder"):
        train_model(tmp_path, "two-stage", single, QUICK, command="")


def test_an_unknown_network_lists_the_known_ones():
    with pytest.raises(TrainingError, match="two-stage"):
        recipe_for("three-stage")


def test_what_is_not_chosen_stays_the_recipe():
    settings = recipe_for("two-stage").settings
    chosen = adjusted(settings, seed=4, threads=1, epochs=7)
    assert (chosen.seed, chosen.threads, chosen.epochs) == (4, 1, 7)
    assert chosen.learning_rate == settings.learning_rate


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
        adjusted(recipe_for("two-stage").settings, **options)
