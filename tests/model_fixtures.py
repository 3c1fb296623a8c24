"""Model files that tests share: made once, from untrained networks."""

import functools

import pytest

from cablesense_sim.arm import Arm, open_arm
from cablesense_training.inference.metadata import ModelMetadata


def metadata_for(arm: Arm, **changes) -> ModelMetadata:
    """What `cablesense train` would write for that arm."""
    content = {
        "kind": "single-contact",
        "network": "closed-form-corrected",
        "arm": arm,
        "arm_identity": arm.identity,
        "cable_names": arm.cable_names,
        "joint_names": arm.joint_names,
        "pose_aware": True,
        "pose_range_deg": 10.0,
        "force_range_n": 200.0,
        "tare_samples": 50,
        "command": "cablesense train --arm cdsm",
        "seed": 0,
        "version": "0.1.0",
    }
    return ModelMetadata(**content | changes)


@pytest.fixture(scope="session")
def model_files(tmp_path_factory):
    """Gives the model file of an untrained network by (network name, arm name)."""
    folder = tmp_path_factory.mktemp("models")

    @functools.cache
    def model_file(network_name="closed-form-corrected", arm_name="cdsm"):
        # torch takes seconds to import, and most tests need none of this
        from cablesense_training.export import export_model
        from cablesense_training.networks import MultiContactNetwork
        from cablesense_training.recipes import build_network

        arm = open_arm(arm_name)
        network = build_network(network_name, arm)
        several = isinstance(network, MultiContactNetwork)
        path = folder / f"{arm_name}_{network_name}.onnx"
        metadata = metadata_for(
            arm,
            network=network_name,
            kind="multi-contact" if several else "single-contact",
            pose_aware=network.pose_aware,
        )
        export_model(network, path, metadata)
        return path

    return model_file


@pytest.fixture(scope="session")
def temporal_model_file(tmp_path_factory):
    """The model file of a network with memory and weights by chance, for `cdsm`."""
    import torch

    from cablesense_training.export import export_model
    from cablesense_training.inference.metadata import SEQUENCE_UNITS
    from cablesense_training.networks.temporal import TemporalNetwork

    arm = open_arm("cdsm")
    path = tmp_path_factory.mktemp("temporal") / "cdsm_temporal.onnx"
    metadata = metadata_for(
        arm,
        network="temporal",
        units=dict(SEQUENCE_UNITS),
        memory=TemporalNetwork.for_arm(arm).memory,
        hidden=TemporalNetwork.for_arm(arm).hidden,
        tick_s=0.02,
        joint_speed_deg_s=20.0,
    )
    with torch.random.fork_rng():
        torch.manual_seed(0)
        network = TemporalNetwork.for_arm(arm)
        for head in (network.shift, network.log_std):
            torch.nn.init.normal_(head.weight, std=0.3)
    export_model(network, path, metadata)
    return path
