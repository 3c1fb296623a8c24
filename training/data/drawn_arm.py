"""Effects drawn at random, so that a network learns arms that nobody has measured yet.

Sizes are normal with their typical size for a standard deviation (one-sided where they cannot be
negative), places are any of those that the effect can have. What a careful workshop leaves, the
tolerances, is everywhere at once.
"""

from __future__ import annotations

import numpy as np

from cablesense_sim.effects.effect import Parameter
from cablesense_sim.effects.entry import EffectEntry
from cablesense_sim.effects.registry import known_effects
from cablesense_training.data.errors import DatasetError

ALL = "all"
"""Stands for every effect that is known."""


def effect_names(randomise: str) -> list[str]:
    """The effects that an option means, in alphabetical order, each once.

    Raises:
        DatasetError: an effect that is not known, or none.
    """
    if not isinstance(randomise, str):
        raise DatasetError(f"randomise = {randomise!r}: must be names of effects, or {ALL}")
    names = [name.strip() for name in randomise.split(",")]
    if names == [ALL]:
        return list(known_effects())
    for name in names:
        if name not in known_effects():
            raise DatasetError(
                f"randomise = {randomise!r}: {name!r} is no effect; give {ALL}, or names from "
                f"{', '.join(known_effects())}, with commas between them"
            )
    return sorted(set(names))


def drawn_entries(
    names: list[str], segment_count: int, cable_count: int, rng: np.random.Generator
) -> list[EffectEntry]:
    """One arm's effects: each of `names` at a place of its own, tolerances at all of theirs."""
    entries = []
    for name in names:
        effect = known_effects()[name]
        places = effect.places(segment_count, cable_count)
        if not effect.tolerance:
            places = (places[int(rng.integers(len(places)))],)
        parameters = (*effect.parameters, *effect.history(segment_count, cable_count))
        entries += [
            EffectEntry(effect, place, {p.name: _value(p, rng) for p in parameters})
            for place in places
        ]
    return entries


def _value(parameter: Parameter, rng: np.random.Generator) -> float:
    if parameter.role == "shape":
        choices = parameter.trials or parameter.starts
        if choices:
            return float(rng.choice(choices))
        return float(rng.uniform(parameter.low, parameter.high))
    size = rng.normal(0.0, parameter.typical)
    if parameter.low == 0.0:
        size = abs(size)
    return float(np.clip(size, parameter.low, parameter.high))
