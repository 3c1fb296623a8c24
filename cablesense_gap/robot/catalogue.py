"""Every effect of a robot, and what a list of them makes of it."""

from __future__ import annotations

import importlib
import pkgutil
from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import groupby
from types import MappingProxyType

from cablesense_gap.robot import effects
from cablesense_gap.robot.effects.effect import PRESLIDING, Effect, Scale
from cablesense_gap.robot.model import Change, Robot
from cablesense_gap.simulator import Assignment, Candidate, Term


@cache
def known_effects() -> Mapping[str, Effect]:
    """Effects by name, tolerances included: those of the folder `effects`."""
    found = {}
    for module in pkgutil.iter_modules(effects.__path__, f"{effects.__name__}."):
        for value in vars(importlib.import_module(module.name)).values():
            if isinstance(value, type) and issubclass(value, Effect) and value is not Effect:
                found[value.name] = value()
    return MappingProxyType(dict(sorted(found.items())))


def candidate(effect: Effect, robot: Robot, scale: Scale) -> Candidate:
    """An effect as the search knows it."""
    return Candidate(
        effect.name,
        effect.places(robot),
        effect.parameters(robot, scale),
        against_motion=effect.against_motion,
    )


def changed(robot: Robot, lists: Sequence[Assignment]) -> Change:
    """The robot with effects, one list after the other, each in the order of its names.

    Numbers that a list does not give are zero.
    """
    change = robot.nominal()
    for values in lists:
        for (name, place), terms in groupby(sorted(values), key=lambda term: term[:2]):
            effect = known_effects()[name]
            numbers = defaultdict(float, {t.parameter: values[t] for t in terms})
            effect.act(change, effect.places(robot).index(place), numbers)
    return change


def in_model(values: Mapping[Term, float]) -> dict[Term, float]:
    """Those that an MJCF can say."""
    return {
        term: value
        for term, value in values.items()
        if known_effects()[term.effect].in_model and term.parameter != PRESLIDING
    }
