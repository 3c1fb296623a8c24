"""Metadata of model files that tests share."""

from cablesense_contact.inference.metadata import ModelMetadata
from cablesense_sim.arm import Arm


def metadata_for(arm: Arm, **changes) -> ModelMetadata:
    """What `cablesense train` would write for that arm."""
    content = {
        "kind": "single-contact",
        "network": "two-stage",
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
