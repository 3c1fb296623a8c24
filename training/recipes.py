"""The networks by the names that commands and model files use: how each is made and trained."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import torch

from cablesense_sim.arm import Arm
from cablesense_training.errors import TrainingError
from cablesense_training.fit import FitSettings
from cablesense_training.inference.history_simulation import without_history
from cablesense_training.inference.metadata import HISTORY_SIMULATED
from cablesense_training.networks.corrected import (
    CorrectedClosedForm,
    MultiContactClosedForm,
    closed_form_without_history,
    plain_closed_form,
)
from cablesense_training.networks.layers import ContactNetwork
from cablesense_training.networks.learnt import (
    DecoupledNetwork,
    ScaleAwareNetwork,
    SharedBackboneNetwork,
    TwoStageMultiContactNetwork,
    TwoStageNetwork,
)
from cablesense_training.networks.statics import AnywhereStatics
from cablesense_training.networks.temporal import TemporalNetwork


@dataclass(frozen=True)
class Recipe:
    """How a network is trained unless chosen otherwise: the least that reached its accuracy.

    Attributes:
        learns_from: kind of the protocol of its samples, or `motion` for sequences.
        build: makes it for an arm and the number of readings averaged into a tare.
        samples: how many of these, or sequences, to draw.
        drawn_on: the arm whose samples it learns from, where it is behind what undoes the rest.
    """

    learns_from: Literal["single", "multi", "anywhere", "motion"]
    build: Callable[[Arm, int], ContactNetwork | TemporalNetwork]
    samples: int
    settings: FitSettings = field(default_factory=FitSettings)
    drawn_on: Callable[[Arm], Arm] = lambda arm: arm


_CORRECTED = FitSettings(epochs=20, batch_size=1024, learning_rate=5e-3, stop_patience=4)

RECIPES: dict[str, Recipe] = {
    "anywhere": Recipe("anywhere", AnywhereStatics.for_arm, 20_000),
    "closed-form": Recipe("single", plain_closed_form, 20_000),
    "closed-form-corrected": Recipe("single", CorrectedClosedForm.for_arm, 40_000, _CORRECTED),
    HISTORY_SIMULATED: Recipe(
        "single", closed_form_without_history, 40_000, _CORRECTED, without_history
    ),
    "decoupled": Recipe("single", DecoupledNetwork.for_arm, 100_000),
    "shared-backbone": Recipe("single", SharedBackboneNetwork.for_arm, 100_000),
    "two-stage": Recipe("single", TwoStageNetwork.for_arm, 100_000),
    "scale-aware": Recipe(
        "single",
        ScaleAwareNetwork.for_arm,
        300_000,
        FitSettings(epochs=45, batch_size=1024, tolerance=5e-3, decay=0.6),
    ),
    "multi-contact": Recipe("multi", TwoStageMultiContactNetwork.for_arm, 100_000),
    "multi-contact-closed-form": Recipe(
        "multi",
        MultiContactClosedForm.for_arm,
        50_000,
        FitSettings(epochs=20, batch_size=1024, learning_rate=1e-2),
    ),
    "temporal": Recipe(
        "motion",
        TemporalNetwork.for_arm,
        256,
        FitSettings(epochs=20, batch_size=32, learning_rate=3e-3),
    ),
}


def recipe_for(name: str) -> Recipe:
    """The recipe of a network.

    Raises:
        TrainingError: there is no network of that name; the message lists those there are.
    """
    if name not in RECIPES:
        raise TrainingError(f"no network {name!r}; there are: {', '.join(RECIPES)}")
    return RECIPES[name]


def build_network(
    name: str, arm: Arm, seed: int = 0, tare_samples: int = 50
) -> ContactNetwork | TemporalNetwork:
    """A network for an arm with the initial weights that the seed gives; see `recipe_for`."""
    recipe = recipe_for(name)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return recipe.build(arm, tare_samples)
