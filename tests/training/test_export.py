"""Networks are exported as model files that answer alike, and are found by name."""

import numpy as np
import onnx
import pytest
import torch
from arm_variants import variant
from model_fixtures import metadata_for

from cablesense_sim.arm import open_arm
from cablesense_training import export
from cablesense_training.errors import ModelFileError, TrainingError
from cablesense_training.export import AGREEMENT, export_model
from cablesense_training.inference.estimator import Estimator, MultiEstimator
from cablesense_training.inference.metadata import bundled_models, find_model
from cablesense_training.inference.model_file import read_model
from cablesense_training.inference.session import COMMAND, TENSION
from cablesense_training.inference.temporal_estimator import open_estimator
from cablesense_training.model_training import build_network
from cablesense_training.networks.learnt import TwoStageNetwork

CDSM = open_arm("cdsm")


def _small_network():
    torch.manual_seed(0)
    return TwoStageNetwork(12, 4, contact_widths=(4,), widths=(4,))


def _metadata(**changes):
    return metadata_for(CDSM, network="two-stage", pose_aware=False, **changes)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["closed-form-corrected", "multi-contact"])
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
    found = session.run({TENSION: tension} | ({COMMAND: command} if network.pose_aware else {}))
    for here, there in zip(expected, found, strict=True):
        np.testing.assert_allclose(there[1:], here[1:], rtol=AGREEMENT, atol=AGREEMENT)
        assert np.isfinite(there).all()


@pytest.mark.slow
def test_a_graph_in_which_another_size_is_large_is_exported(tmp_path):
    """Six segments with three stiff cables each expand 732 numbers about every joint."""
    arm = variant(
        {
            "segments.count": 6,
            "segments.length_m": [0.113, 0.143, 0.103, 0.077, 0.184, 0.097],
            "segments.contact_m": [0.056, 0.072, 0.052, 0.038, 0.092, 0.048],
            "segments.mass_kg": 0.114,
            "segments.plate_offset_m": 0.012,
            "cables.routing_radius_m": 0.063,
            "cables.angle_deg": {"first": 0.0, "per_segment": 20.0, "per_cable": -120.0},
            "cables.stiffness_n_m": 6.49e6,
        },
        "cdsm_lab",
    )
    path, name = tmp_path / "model.onnx", "anywhere"
    metadata = metadata_for(arm, network=name, kind="contact-anywhere")
    export_model(build_network(name, arm), path, metadata)
    assert onnx.load(path).graph.node


@pytest.mark.slow
def test_a_failed_check_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setattr(export, "AGREEMENT", -1.0)
    kept = tmp_path / "model.onnx"
    kept.write_text("what was there")
    with pytest.raises(TrainingError, match="differs by"):
        export_model(_small_network(), kept, _metadata())
    assert [path.name for path in tmp_path.iterdir()] == ["model.onnx"]
    assert kept.read_text() == "what was there"


@pytest.mark.parametrize("name", bundled_models())
def test_every_bundled_model_opens_for_the_bundled_arm_it_was_made_for(name):
    _, metadata = read_model(find_model(name))
    load = MultiEstimator.load if metadata.kind == "multi-contact" else open_estimator
    assert load(find_model(name), open_arm(metadata.arm.name)).metadata == metadata


@pytest.mark.parametrize("name", ["", "cdsn", "../models/cdsm", "mine.onnx"])
def test_what_is_neither_lists_the_names_there_are(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ModelFileError, match="cdsm"):
        find_model(name)
