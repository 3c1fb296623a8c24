"""Every effect that is known: the files of this folder, and what other packages offer."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from functools import cache
from importlib.metadata import entry_points
from types import MappingProxyType

from cablesense_msgs_py.errors import CableSenseError
from cablesense_sim import effects
from cablesense_sim.effects.effect import Effect

ENTRY_POINTS = "cablesense.effects"
"""The group under which another package offers its effects: classes derived from `Effect`."""


class EffectError(CableSenseError):
    """An effect that cannot be: unknown, in a wrong place, or with a number out of range."""


@cache
def known_effects() -> Mapping[str, Effect]:
    """Effects by name, tolerances included.

    Raises:
        EffectError: what another package offers cannot be loaded or takes a name that is taken.
    """
    found: dict[str, Effect] = {}
    for module in pkgutil.iter_modules(effects.__path__, f"{effects.__name__}."):
        for value in vars(importlib.import_module(module.name)).values():
            if _is_effect(value) and value.__module__ == module.name:
                found[value.name] = value()
    for offered in entry_points(group=ENTRY_POINTS):
        try:
            value = offered.load()
        except Exception as error:  # whatever a stranger's module raises
            raise EffectError(f"effect {offered.name} of {offered.value}: {error}") from error
        if not _is_effect(value):
            raise EffectError(f"effect {offered.name}: {offered.value} is no class of effect")
        if value.name in found:
            raise EffectError(f"effect {value.name} of {offered.value}: the name is taken")
        found[value.name] = value()
    return MappingProxyType(dict(sorted(found.items())))


def _is_effect(value: object) -> bool:
    return isinstance(value, type) and issubclass(value, Effect) and value is not Effect
