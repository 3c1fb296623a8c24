"""Bundled models are found by name, others by path, and what is neither is said to be."""

import pytest

from cablesense_base.installation import config_path
from cablesense_sim.arm import open_arm
from cablesense_training.inference.estimator import MultiEstimator
from cablesense_training.inference.metadata import ModelFileError, bundled_models, find_model
from cablesense_training.inference.session import read_model
from cablesense_training.inference.temporal_estimator import open_estimator


def test_every_bundled_model_is_found_by_its_name():
    names = bundled_models()
    assert "cdsm" in names
    for name in names:
        assert find_model(name) == config_path(f"models/{name}.onnx")


@pytest.mark.parametrize("name", bundled_models())
def test_every_bundled_model_opens_for_the_bundled_arm_it_was_made_for(name):
    _, metadata = read_model(find_model(name))
    load = MultiEstimator.load if metadata.kind == "multi-contact" else open_estimator
    assert load(find_model(name), open_arm(metadata.arm.name)).metadata == metadata


def test_models_in_a_folder_have_its_name(tmp_path, monkeypatch):
    (tmp_path / "peers").mkdir()
    for name in ("arm.onnx", "peers/arm.onnx", "peers/notes.txt"):
        (tmp_path / name).touch()
    monkeypatch.setattr(
        "cablesense_base.installation.config_path",
        lambda name: tmp_path / name.removeprefix("models").lstrip("/"),
    )
    assert bundled_models() == ["arm", "peers/arm"]
    assert find_model("peers/arm") == tmp_path / "peers" / "arm.onnx"


def test_a_path_is_taken_as_it_is(tmp_path):
    path = tmp_path / "mine.onnx"
    path.touch()
    assert find_model(path) == find_model(str(path)) == path


@pytest.mark.parametrize(
    "name",
    [
        "",
        "cdsn",
        "cdsm.onnx",
        "../models/cdsm",
        "peers",
        "/",
        "mine.onnx",
        "mine.onnx/",
        "\x00.onnx",
        "a" * 5000 + ".onnx",
        "two\nlines",
    ],
)
def test_what_is_neither_lists_the_names_there_are(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ModelFileError, match="cdsm"):
        find_model(name)


def test_a_folder_is_no_model(tmp_path):
    folder = tmp_path / "folder.onnx"
    folder.mkdir()
    with pytest.raises(ModelFileError, match="no model file"):
        find_model(folder)
