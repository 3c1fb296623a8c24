"""How each network is trained unless told otherwise: the least that reached its figures.

The networks by the name that commands and model files use.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch

from cablesense_sim.arm import Arm
from cablesense_training.errors import TrainingError
from cablesense_training.fit import FitSettings
from cablesense_training.networks import Network
from cablesense_training.networks.corrected import CorrectedClosedForm, PlainClosedForm
from cablesense_training.networks.multi_contact import (
    MultiContactClosedForm,
    TwoStageMultiContactNetwork,
)
from cablesense_training.networks.single_contact import (
    DecoupledNetwork,
    ScaleAwareNetwork,
    SharedBackboneNetwork,
    TwoStageNetwork,
)


@dataclass(frozen=True)
class Recipe:
    """Number of samples to draw, and the training settings."""

    samples: int
    settings: FitSettings


_PAPER = Recipe(100_000, FitSettings())

RECIPES: dict[str, Recipe] = {
    "closed-form": Recipe(20_000, FitSettings()),
    "closed-form-corrected": Recipe(
        40_000, FitSettings(epochs=20, batch_size=1024, learning_rate=5e-3, stop_patience=4)
    ),
    "decoupled": _PAPER,
    "shared-backbone": _PAPER,
    "two-stage": _PAPER,
    "scale-aware": Recipe(
        300_000, FitSettings(epochs=45, batch_size=1024, tolerance=5e-3, decay=0.6)
    ),
    "multi-contact": _PAPER,
    "multi-contact-closed-form": Recipe(
        50_000, FitSettings(epochs=20, batch_size=1024, learning_rate=1e-2)
    ),
}
"""Recipes by the names of `networks.registry.NETWORKS`."""


def recipe_for(network_name: str) -> Recipe:
    """The recipe of a network.

    Raises:
        TrainingError: there is no network of that name; the message lists those there are.
    """
    if network_name not in RECIPES:
        raise TrainingError(f"no network {network_name!r}; there are: {', '.join(RECIPES)}")
    return RECIPES[network_name]


def adjusted(
    settings: FitSettings,
    *,
    seed: int,
    threads: int,
    epochs: int | None = None,
    batch_size: int | None = None,
    learning_rate: float | None = None,
) -> FitSettings:
    """A recipe's settings with what a caller chose otherwise.

    Raises:
        TrainingError: a value out of range.
    """
    chosen = replace(
        settings,
        seed=seed,
        threads=threads,
        epochs=settings.epochs if epochs is None else epochs,
        batch_size=settings.batch_size if batch_size is None else batch_size,
        learning_rate=settings.learning_rate if learning_rate is None else learning_rate,
    )
    for name in ("epochs", "batch_size", "threads"):
        if getattr(chosen, name) < 1:
            raise TrainingError(f"{name} = {getattr(chosen, name)}: must be at least 1")
    if not 0.0 < chosen.learning_rate <= 1.0:
        raise TrainingError(f"learning_rate = {chosen.learning_rate:g}: must be in (0, 1]")
    return chosen


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
