"""What a model file says about itself comes back, and what cannot be true is refused."""

import json

import pytest
from model_fixtures import metadata_for

from cablesense_sim.arm import open_arm
from cablesense_training.inference.metadata import (
    FORMAT,
    ModelFileError,
    ModelMetadata,
    effect_versions,
)

CDSM = open_arm("cdsm")


def _changed(change):
    """Properties whose JSON content was altered."""
    [(key, text)] = metadata_for(CDSM).to_properties().items()
    content = json.loads(text)
    change(content)
    return {key: json.dumps(content)}


def _refused(properties):
    with pytest.raises(ModelFileError) as caught:
        ModelMetadata.from_properties(properties, "arm.onnx")
    message = str(caught.value)
    assert message.startswith("arm.onnx: ")
    assert "\n" not in message
    return message


@pytest.mark.parametrize("arm", ["cdsm", "cdsm_lab", "cdsm_table2"])
def test_metadata_come_back_as_they_went(arm):
    metadata = metadata_for(open_arm(arm))
    assert ModelMetadata.from_properties(metadata.to_properties(), "x") == metadata


def test_a_model_that_was_trained_on_an_older_law_is_refused_with_the_remedy():
    metadata = metadata_for(open_arm("cdsm_friction"))
    current = metadata.model_copy(update={"effect_versions": effect_versions(metadata.arm)})
    assert ModelMetadata.from_properties(current.to_properties(), "arm.onnx") == current
    refusal = _refused(metadata.to_properties())
    assert "version 1 of the law of capstan_friction" in refusal
    assert refusal.endswith(f"train it again: {metadata.command}")


def test_a_rigid_actuator_passes_through_strict_json():
    content = CDSM.model_dump()
    content["actuators"]["kp_n_m"] = float("inf")
    metadata = metadata_for(type(CDSM).model_validate(content))
    properties = metadata.to_properties()

    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    json.loads(next(iter(properties.values())), parse_constant=refuse)
    back = ModelMetadata.from_properties(properties, "x")
    assert back == metadata
    assert back.arm.actuators.kp_n_m == float("inf")


@pytest.mark.parametrize("version", ["cablesense-model/2", None, 7])
def test_another_format_names_both(version):
    message = _refused(_changed(lambda content: content.update(format=version)))
    assert repr(version) in message
    assert FORMAT in message


def test_an_altered_arm_is_noticed():
    def heavier(content):
        content["arm"]["segments"]["mass_kg"] = 0.6

    assert "altered" in _refused(_changed(heavier))


@pytest.mark.parametrize("key", ["cable_names", "joint_names"])
def test_inputs_in_another_order_than_the_arms_are_refused(key):
    message = _refused(_changed(lambda content: content[key].reverse()))
    assert ", ".join(getattr(CDSM, key)) in message


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("kind", "double-contact"),
        ("pose_aware", "perhaps"),
        ("pose_range_deg", float("nan")),
        ("force_range_n", -1.0),
        ("tare_samples", 0),
        ("seed", "zero"),
        ("arm", None),
        ("arm", {"name": "x"}),
        ("cable_names", 12),
        ("invented", 1),
    ],
)
def test_a_value_that_cannot_be_true_is_named(key, value):
    assert key in _refused(_changed(lambda content: content.update({key: value})))


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "null", "7", '"x"', "\x00", "[" * 100_000, '{"format": {}}']
)
def test_text_that_is_no_description_is_refused(text):
    _refused({"cablesense": text})
