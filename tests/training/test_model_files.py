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
