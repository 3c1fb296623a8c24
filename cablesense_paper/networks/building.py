"""Networks of the shapes that are tried."""

from __future__ import annotations

from collections.abc import Callable

import torch

from cablesense_paper.networks.shapes import DECOUPLED, SHARED_TRUNK, TWO_STAGE, Shape
from cablesense_sim.arm import Arm
from cablesense_training.networks import SingleContactNetwork
from cablesense_training.networks.decoupled import DecoupledNetwork
from cablesense_training.networks.shared_backbone import SharedBackboneNetwork
from cablesense_training.networks.two_stage import TwoStageNetwork

_BUILDERS: dict[str, Callable[[int, int, list[int]], SingleContactNetwork]] = {
    DECOUPLED: lambda cables, segments, widths: DecoupledNetwork(cables, segments, widths),
    SHARED_TRUNK: lambda cables, segments, widths: SharedBackboneNetwork(cables, segments, widths),
    TWO_STAGE: lambda cables, segments, widths: TwoStageNetwork(
        cables, segments, widths[:-1] or widths, widths
    ),
}


def build(shape: Shape, arm: Arm, seed: int) -> SingleContactNetwork:
    """A network of that shape for an arm, with the initial weights that the seed gives."""
    widths = [shape.width] * shape.depth
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return _BUILDERS[shape.architecture](arm.cable_count, arm.segment_count, widths)


def parameters(network: SingleContactNetwork) -> int:
    """Trained numbers behind the answers; those that state the uncertainty do not count."""
    return sum(
        part.numel() for name, part in network.named_parameters() if not name.startswith("spread.")
    )
