"""The largest misfit of healthy arms stands in the model file, and nothing else changes in it."""

import numpy as np
import pytest
from arm_at_rest import Arm

from cablesense_base.installation import config_path
from cablesense_online import misfit_limit
from cablesense_online.misfit_limit import put_simulated_limit, simulated_misfits
from cablesense_online.models import LoadedModel, load_model
from cablesense_training.inference.metadata import MisfitLimit
from cablesense_training.inference.session import replace_misfit_limit

pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark

CHECKED = ["cdsm", "cdsm_lab", "cdsm_table2", "cdsm_tensions_only"]
OTHER = MisfitLimit(largest_misfit=7.5, false_alarm_rate=0.25, samples=40, above=10)


def copied(tmp_path, name="cdsm"):
    path = tmp_path / f"{name}.onnx"
    path.write_bytes(config_path(f"models/{name}.onnx").read_bytes())
    return path


@pytest.mark.parametrize("name", CHECKED)
def test_another_limit_changes_nothing_else_of_a_file_nor_the_models_identity(tmp_path, name):
    path = copied(tmp_path, name)
    origin = LoadedModel.open(path).origin
    assert LoadedModel.open(path).estimator.metadata.misfit_limit is not None
    replace_misfit_limit(path, None)
    without = path.read_bytes()
    replace_misfit_limit(path, OTHER)
    loaded = LoadedModel.open(path)
    assert path.read_bytes().startswith(without)
    assert loaded.estimator.metadata.misfit_limit == OTHER
    assert loaded.origin == origin
    replace_misfit_limit(path, None)
    assert path.read_bytes() == without


def test_the_parameter_overrides_the_file_and_a_file_without_one_has_the_default(tmp_path):
    path = copied(tmp_path)
    replace_misfit_limit(path, OTHER)
    assert LoadedModel.open(path).largest_misfit(-1.0) == 7.5
    assert LoadedModel.open(path).largest_misfit(3.0) == 3.0
    assert LoadedModel.open(path).largest_misfit(0.0) == 0.0
    replace_misfit_limit(path, None)
    assert LoadedModel.open(path).largest_misfit(-1.0) == 2.3


@pytest.mark.parametrize(
    ("stated", "largest", "origin"),
    [
        (OTHER, -1.0, "of the model file: above it are 10 of 40 simulated healthy samples"),
        (OTHER, 3.0, "of the parameter largest_misfit"),
        (None, -1.0, "by default: the model file states none"),
    ],
)
def test_diagnostics_state_where_the_limit_comes_from(tmp_path, stated, largest, origin):
    path = copied(tmp_path)
    replace_misfit_limit(path, stated)
    largest = LoadedModel.open(path).largest_misfit(largest)
    arm = Arm(model=str(path), largest_misfit=largest)
    values = arm.estimation.plausibility.status().values
    assert values["largest misfit that passes"] == f"{largest:g}"
    assert values["this limit is"].startswith(origin)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cdsm_lab"])
def test_fresh_healthy_samples_are_as_rarely_above_the_limit_as_it_states(
    tmp_path, monkeypatch, name
):
    monkeypatch.setattr(misfit_limit, "POSES", 3)
    limit = put_simulated_limit(copied(tmp_path, name))
    monkeypatch.setattr(misfit_limit, "POSES", 1)
    fresh = np.fromiter(simulated_misfits(load_model(name, ""), seed=1), float)
    spare = 3.0 * np.sqrt(max(limit.above, 1) * misfit_limit.READINGS)  # of a contact all are
    assert (fresh > limit.largest_misfit).sum() <= limit.above + spare
    assert np.median(fresh) == pytest.approx(1.0, abs=0.2)


@pytest.mark.slow
def test_a_model_with_memory_gets_none(tmp_path):
    assert put_simulated_limit(copied(tmp_path, "cdsm_moving")) is None
