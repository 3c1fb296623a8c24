"""The networks by the name that commands and model files use."""

from __future__ import annotations

from collections.abc import Callable

import torch

from cablesense_sim.arm import Arm
from cablesense_training.errors import TrainingError
from cablesense_training.networks import Network
from cablesense_training.networks.decoupled import DecoupledNetwork
from cablesense_training.networks.multi_contact import TwoStageMultiContactNetwork
from cablesense_training.networks.scale_aware import ScaleAwareNetwork
from cablesense_training.networks.shared_backbone import SharedBackboneNetwork
from cablesense_training.networks.two_stage import TwoStageNetwork
from cablesense_training.physics.corrected import CorrectedClosedForm, PlainClosedForm
from cablesense_training.physics.multi_contact import MultiContactClosedForm

NETWORKS: dict[str, Callable[[Arm], Network]] = {
    "closed-form": PlainClosedForm.for_arm,
    "closed-form-corrected": CorrectedClosedForm.for_arm,
    "decoupled": lambda arm: DecoupledNetwork(arm.cable_count, arm.segment_count),
    "shared-backbone": lambda arm: SharedBackboneNetwork(arm.cable_count, arm.segment_count),
    "two-stage": lambda arm: TwoStageNetwork(arm.cable_count, arm.segment_count),
    "scale-aware": lambda arm: ScaleAwareNetwork(arm.cable_count, arm.segment_count),
    "multi-contact-closed-form": MultiContactClosedForm.for_arm,
    "multi-contact": lambda arm: TwoStageMultiContactNetwork(arm.cable_count, arm.segment_count),
}
"""How each network is made for an arm."""


def build_network(name: str, arm: Arm, seed: int = 0) -> Network:
    """A network for an arm with the initial weights that the seed gives.

    Raises:
        TrainingError: there is no network of that name; the message lists those there are.
    """
    if name not in NETWORKS:
        raise TrainingError(f"no network {name!r}; there are: {', '.join(NETWORKS)}")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return NETWORKS[name](arm)
