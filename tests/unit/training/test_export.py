"""Networks are exported as model files that answer alike, and are found by name."""

import numpy as np
import onnx
import pytest
import torch

from cablesense_contact.errors import ModelFileError
from cablesense_contact.inference.estimator import Estimator, MultiEstimator
from cablesense_contact.inference.law_model import LawModel
from cablesense_contact.inference.metadata import bundled_models, find_model, find_model_of
from cablesense_contact.inference.model_file import read_model
from cablesense_contact.inference.session import TENSION
from cablesense_sim.arm import open_arm
from cablesense_training import export
from cablesense_training.errors import TrainingError
from cablesense_training.export import AGREEMENT, export_model
from cablesense_training.model_training import build_network
from cablesense_training.networks.learnt import TwoStageNetwork
from tests.helpers.model_fixtures import metadata_for

pytestmark = pytest.mark.exports

CDSM = open_arm("cdsm")


def _small_network():
    torch.manual_seed(0)
    return TwoStageNetwork(12, 4, contact_widths=(4,), widths=(4,))


def _metadata(**changes):
    return metadata_for(CDSM, network="two-stage", pose_aware=False, **changes)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two-stage", "multi-contact"])
def test_the_file_answers_as_pytorch_does_and_names_no_path_of_this_machine(name, tmp_path):
    network = build_network(name, CDSM)
    several = network.several
    path = tmp_path / "model.onnx"
    metadata = metadata_for(
        CDSM,
        network=name,
        kind="multi-contact" if several else "single-contact",
        pose_aware=network.pose_aware,
    )
    export_model(network, path, metadata)
    for trace in (b"/home", b"/work", b"/tmp", b"site-packages", b".py"):
        assert trace not in path.read_bytes()
    onnx.checker.check_model(onnx.load(path))
    assert path.stat().st_size < 2_000_000
    network = network.double().eval()
    rng = np.random.default_rng(0)
    tension = rng.normal(0.0, 1.0, (200, 12)) * rng.uniform(0.0, 80.0, (200, 1))
    command = rng.uniform(-0.17, 0.17, (200, 8))
    tension[0] = 0.0  # at rest only the direction is anybody's guess
    with torch.no_grad():
        output = network(torch.as_tensor(tension), torch.as_tensor(command))
    if several:
        expected = [torch.sigmoid(output.contact_logits), *output[1:]]
        session = MultiEstimator.load(path, CDSM)
    else:
        direction = torch.nn.functional.normalize(output.direction, dim=-1)
        expected = [torch.softmax(output.contact_logits, dim=-1), direction, *output[2:]]
        session = Estimator.load(path, CDSM)
    answers = session.run({TENSION: tension})
    for here, there in zip(expected, answers, strict=True):
        np.testing.assert_allclose(there[1:], here[1:], rtol=AGREEMENT, atol=AGREEMENT)
        assert np.isfinite(there).all()


@pytest.mark.slow
def test_a_failed_check_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setattr(export, "AGREEMENT", -1.0)
    kept = tmp_path / "model.onnx"
    kept.write_text("what was there")
    with pytest.raises(TrainingError, match="differs by"):
        export_model(_small_network(), kept, _metadata())
    assert [path.name for path in tmp_path.iterdir()] == ["model.onnx"]
    assert kept.read_text() == "what was there"


NETWORKS = {
    "peers/cdsm_two_stage": Estimator,
    "peers/cdsm_straight_two_stage": Estimator,
    "peers/cdsm_table2_two_stage": Estimator,
    "peers/cdsm_multi_two_stage": MultiEstimator,
}


@pytest.mark.parametrize("name", bundled_models())
def test_every_bundled_model_opens_for_the_bundled_arm_it_was_made_for(name):
    _, metadata = read_model(find_model(name))
    arm = open_arm(metadata.arm.name)
    assert NETWORKS.get(name, LawModel)(find_model(name), arm).metadata == metadata


def test_every_bundled_arm_has_its_estimator():
    arms = ("cdsm", "cdsm_friction", "cdsm_lab", "cdsm_table2")
    assert set(bundled_models()) == {f"{name}_anywhere" for name in arms} | set(NETWORKS)
    for name in arms:
        assert find_model_of(open_arm(name), name).stem == f"{name}_anywhere"
    renamed = CDSM.model_copy(update={"name": "own"})
    with pytest.raises(ModelFileError, match=r"cablesense export --arm own\.yaml --out own\.onnx"):
        find_model_of(renamed, "own.yaml")


@pytest.mark.slow
def test_constants_stored_in_single_precision_lose_nothing(tmp_path):
    """Weights are trained in float32: the graph with and without casts answers alike."""
    path = tmp_path / "model.onnx"
    export_model(_small_network(), path, _metadata())
    stored = onnx.load(path)
    kinds = {constant.name: constant.data_type for constant in stored.graph.initializer}
    casts = [
        node for node in stored.graph.node if node.input[0] in kinds and node.op_type == "Cast"
    ]
    assert casts
    assert all(kinds[node.input[0]] == onnx.TensorProto.FLOAT for node in casts)


@pytest.mark.parametrize("name", ["", "cdsn", "../models/cdsm", "mine.onnx"])
def test_what_is_neither_lists_the_names_there_are(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ModelFileError, match="cdsm"):
        find_model(name)
