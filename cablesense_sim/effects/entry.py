"""One effect of an arm file: which, where, and how large."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cablesense_sim.effects.effect import Effect, Values
from cablesense_sim.effects.registry import EffectError, known_effects

if TYPE_CHECKING:
    from cablesense_sim.arm import Arm


@dataclass(frozen=True)
class EffectEntry:
    """An effect with its place and all its parameters."""

    effect: Effect
    place: str
    values: dict[str, float]


def checked_entry(
    name: str, place: str, given: dict[str, float], segment_count: int, cable_count: int
) -> EffectEntry:
    """The entry, with defaults for what is not given.

    Raises:
        EffectError: an unknown effect, place or parameter, or a value outside its range.
    """
    effect = known_effects().get(name)
    if effect is None:
        raise EffectError(f"effect {name!r} is unknown; known: {', '.join(known_effects())}")
    places = effect.places(segment_count, cable_count)
    if place not in places:
        several = ", ".join(places[:6]) + (", …" if len(places) > 6 else "")
        raise EffectError(f"effect {name} cannot be at {place!r}; valid: {several}")
    history = effect.history(segment_count, cable_count)
    parameters = (*effect.parameters, *(p for p in history if p.name in given))
    names = [parameter.name for parameter in (*effect.parameters, *history)]
    for key in given:
        if key not in names:
            raise EffectError(f"effect {name} has no parameter {key!r}; it has {', '.join(names)}")
    for parameter in parameters:
        value = given.get(parameter.name, parameter.default)
        if not parameter.low <= value <= parameter.high:
            raise EffectError(
                f"effect {name} at {place}: {parameter.name} = {value:g} {parameter.unit} must be "
                f"from {parameter.low:g} to {parameter.high:g}"
            )
    values = {p.name: float(given.get(p.name, p.default)) for p in parameters}
    return EffectEntry(effect, place, values)


def entries_of(arm: Arm) -> list[EffectEntry]:
    """The effects that an arm file lists, in its order."""
    return [
        checked_entry(
            listed.effect, listed.at, listed.parameters, arm.segment_count, arm.cable_count
        )
        for listed in arm.effects
    ]


def side_by_side(entries: Sequence[EffectEntry]) -> Values:
    """The values of one effect in P arms, each (P,)."""
    return {
        name: np.array([entry.values[name] for entry in entries]) for name in entries[0].values
    }
