"""The metrics of `cablesense evaluate`: one table of samples, every model, in strict JSON."""

import json

import pytest

from cablesense_contact.errors import ModelFileError
from cablesense_contact.inference.metadata import find_model
from cablesense_contact.inference.single_contact import open_estimator
from cablesense_training.data.generation import draw_dataset
from cablesense_training.evaluation import comparison
from cablesense_training.evaluation.comparison import (
    SETTINGS,
    TABLE2_MODELS,
    Setting,
    compare,
    evaluate_setting,
    evaluate_table2,
)

METRICS = {
    "contact_accuracy",
    "direction_mae_deg",
    "magnitude_mae_n",
    "magnitude_rmse_n",
    "macro_f1",
    "coverage95",
    "by_force",
}


@pytest.mark.slow
def test_every_setting_every_model_and_the_bound_on_the_same_samples():
    named = []
    result = compare(7, 150, on_setting=named.append)
    assert named == [setting.name for setting in SETTINGS] + ["multi"]

    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    content = json.loads(json.dumps(result), parse_constant=refuse)
    names = {"straight", "random_pose", "compliant"}
    assert content["seed"] == 7
    assert content["samples"] == 150
    assert set(content["single"]) == set(content["bound"]) == names
    for metrics in content["single"].values():
        assert set(metrics) == METRICS | {"mae_over_bound"}
    for name, baseline in content["peers"].items():
        assert set(baseline) <= names, name
    assert set(content["peers"]) == {"two_stage"}
    assert set(content["peers"]["two_stage"]) == names - {"compliant"}
    assert {"recognition_accuracy", "macro_f1", "magnitude_mae_n"} <= set(content["multi"])
    for name in ("straight", "random_pose", "compliant"):
        assert content["single"][name]["contact_accuracy"] > 0.95
        assert content["single"][name]["mae_over_bound"] < 2.0
    assert 0.0 <= content["coverage95"] <= 1.0


def test_a_model_for_another_arm_is_refused(monkeypatch):
    path = find_model("peers/cdsm_two_stage")
    monkeypatch.setattr(comparison, "find_model", lambda name: path)
    setting = Setting("mixed", "cdsm_lab", "straight", {"shipped": "cdsm_anywhere"})
    dataset = draw_dataset(setting.arm, setting.protocol(100), seed=0)
    with pytest.raises(ModelFileError, match="made for arm cdsm-"):
        evaluate_setting(setting, dataset)


def test_the_law_has_the_errors_that_noise_leaves_and_half_of_the_papers_on_its_measured_loads():
    law, network = (
        [abs(each.magnitude_n / each.load.weight_n - 1.0) for each in evaluate_table2(model)]
        for model in map(open_estimator, map(find_model, TABLE2_MODELS.values()))
    )
    assert max(law) < 0.1
    assert sum(law) < sum(network)


def test_a_missing_model_is_named_before_samples_are_drawn(monkeypatch):
    def refuse(*arguments, **options):
        raise AssertionError("samples were drawn for nothing")

    monkeypatch.setattr(comparison, "draw_dataset", refuse)
    monkeypatch.setitem(comparison.MULTI_MODELS, "gone", "cdsm_gone")
    with pytest.raises(ModelFileError, match="unknown model 'cdsm_gone'"):
        compare(0, 100)
