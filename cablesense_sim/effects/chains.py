"""What listed effects do, one after the other: to one mechanism, or to P arms side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeVar

from cablesense_sim.effects.actuation import Actuation
from cablesense_sim.effects.effect import Effect, Values
from cablesense_sim.effects.entry import EffectEntry, side_by_side
from cablesense_sim.effects.sensing import Sensing
from cablesense_sim.effects.transmission import Transmission

if TYPE_CHECKING:
    from cablesense_sim.mechanism import Mechanism

Variants = Sequence[Sequence[EffectEntry]]
"""The entries of P arms, which have the same effects with other numbers."""

_Acting = TypeVar("_Acting")


def amended(mechanism: Mechanism, entries: Sequence[EffectEntry]) -> Mechanism:
    """The mechanism with what its effects change of the arm itself."""
    for entry in entries:
        mechanism = entry.effect.amend(mechanism, entry.place, entry.values)
    return mechanism


def actuations(variants: Variants) -> list[Actuation]:
    """What lies between the commanded and the held cable lengths, each for all arms."""
    return _acting(variants, lambda effect, place, values: effect.actuation(place, values))


def memories(variants: Variants) -> list[Transmission]:
    """What along the cables and in the joints depends on the past, each for all arms."""
    return _acting(variants, lambda effect, place, values: effect.transmission(place, values))


def sensings(variants: Variants) -> list[Sensing]:
    """What lies between tensions and readings, each for all arms."""
    return _acting(variants, lambda effect, place, values: effect.sensing(place, values))


def _acting(
    variants: Variants, made: Callable[[Effect, str, Values], _Acting | None]
) -> list[_Acting]:
    found = []
    for entries in zip(*variants, strict=True):
        acting = made(entries[0].effect, entries[0].place, side_by_side(entries))
        if acting is not None:
            found.append(acting)
    return found
