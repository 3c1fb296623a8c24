"""Every known effect, the entries of arm files, and listed effects applied in their order.

Known are the effects in the modules of this folder, and those that other packages offer under
`ENTRY_POINTS`.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from itertools import groupby
from types import MappingProxyType, ModuleType
from typing import TypeVar

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_sim import effects
from cablesense_sim.effects.effect import (
    Actuation,
    Effect,
    EffectDescription,
    Sensing,
    Transmission,
    Values,
)
from cablesense_sim.mechanism import Mechanism

ENTRY_POINTS = "cablesense.effects"
"""The group under which another package offers its effects: classes derived from `Effect`."""


class EffectError(CableSenseError):
    """An effect that is unknown, at a wrong place, or has a number out of range."""


Kind = TypeVar("Kind", bound=EffectDescription)


def effects_in(package: ModuleType, base: type[Kind]) -> dict[str, Kind]:
    """An instance of each effect that the modules of a package define, by name."""
    instances = {}
    for module in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
        for value in vars(importlib.import_module(module.name)).values():
            defined = isinstance(value, type) and value.__module__ == module.name
            if defined and issubclass(value, base) and value is not base:
                instances[value.name] = value()
    return instances


@cache
def known_effects() -> Mapping[str, Effect]:
    """Effects by name, tolerances included.

    Raises:
        EffectError: an offered effect cannot be loaded, or its name is taken.
    """
    known = effects_in(effects, Effect)
    for offered in entry_points(group=ENTRY_POINTS):
        try:
            value = offered.load()
        except Exception as error:  # a foreign module may raise anything
            raise EffectError(f"effect {offered.name} of {offered.value}: {error}") from error
        if not _is_effect(value):
            raise EffectError(f"effect {offered.name}: {offered.value} is no class of effect")
        if value.name in known:
            raise EffectError(f"effect {value.name} of {offered.value}: the name is taken")
        known[value.name] = value()
    return MappingProxyType(dict(sorted(known.items())))


def _is_effect(value: object) -> bool:
    return isinstance(value, type) and issubclass(value, Effect) and value is not Effect


@dataclass(frozen=True)
class EffectEntry:
    """An effect with its place and all its parameters."""

    effect: Effect
    place: str
    values: dict[str, float]


def checked_entry(
    name: str, place: str, given: dict[str, float], segment_count: int, cable_count: int
) -> EffectEntry:
    """The entry, with defaults for values that are not given.

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
    names = [parameter.name for parameter in (*effect.parameters, *history)]
    for key in given:
        if key not in names:
            raise EffectError(f"effect {name} has no parameter {key!r}; it has {', '.join(names)}")
    values = {}
    for parameter in (*effect.parameters, *(p for p in history if p.name in given)):
        value = values[parameter.name] = float(given.get(parameter.name, parameter.default))
        if not parameter.low <= value <= parameter.high:
            raise EffectError(
                f"effect {name} at {place}: {parameter.name} = {value:g} {parameter.unit} must be "
                f"from {parameter.low:g} to {parameter.high:g}"
            )
    return EffectEntry(effect, place, values)


def side_by_side(entries: Sequence[EffectEntry]) -> Values:
    """The values of one effect in P arms, each (P,)."""
    return {name: np.array([e.values[name] for e in entries]) for name in entries[0].values}


Variants = Sequence[Sequence[EffectEntry]]
"""The entries of P arms, which have the same effects with different numbers."""

_Acting = TypeVar("_Acting")


def amended(mechanism: Mechanism, entries: Sequence[EffectEntry]) -> Mechanism:
    """The mechanism as changed by those effects that act on the arm itself."""
    for effect, its_entries in groupby(sorted(entries, key=_order), key=lambda e: e.effect):
        everywhere = [(entry.place, entry.values) for entry in its_entries]
        mechanism = effect.amend_all(mechanism, everywhere)
    return mechanism


def loadings(variants: Variants) -> list[Array]:
    """Maps from the recorded loads to those that act, (P, 3, 3) each."""
    return _acting(variants, lambda effect, place, values: effect.loading(place, values))


def joint_zeros_rad(variants: Variants, joint_count: int) -> Array | None:
    """(P, 2N) by which angles whose cable lengths are held exceed the commanded ones.

    N is the `joint_count`. None where no effect has any.
    """
    zeros_rad = _acting(
        variants, lambda effect, place, values: effect.joint_zeros_rad(place, values, joint_count)
    )
    return np.sum(zeros_rad, axis=0) if zeros_rad else None


def actuations(variants: Variants) -> list[Actuation]:
    """Effects between the commanded and the held cable lengths, each for all arms."""
    return _acting(variants, lambda effect, place, values: effect.actuation(place, values))


def transmissions(variants: Variants) -> list[Transmission]:
    """History-dependent effects of cables and joints, each for all arms."""
    return _acting(variants, lambda effect, place, values: effect.transmission(place, values))


def sensings(variants: Variants) -> list[Sensing]:
    """Effects between tensions and readings, each for all arms."""
    return _acting(variants, lambda effect, place, values: effect.sensing(place, values))


def _acting(
    variants: Variants, made: Callable[[Effect, str, Values], _Acting | None]
) -> list[_Acting]:
    all_acting = []
    for entries in sorted(zip(*variants, strict=True), key=lambda entries: _order(entries[0])):
        acting = made(entries[0].effect, entries[0].place, side_by_side(entries))
        if acting is not None:
            all_acting.append(acting)
    return all_acting


def _order(entry: EffectEntry) -> tuple[int, str, str, list[tuple[str, float]]]:
    """The order of a file or of a search makes no difference."""
    return entry.effect.order, entry.effect.name, entry.place, sorted(entry.values.items())
