"""The amended arm file: the nominal arm, the effects found, and its own tolerances."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from pathlib import Path

import numpy as np
import yaml

from cablesense_gap.simulator import Term
from cablesense_sim.arm import Arm, ListedEffect, parse_arm
from cablesense_sim.effects.effect import WHOLE_ARM
from cablesense_sim.effects.registry import known_effects


def amended_arm(arm: Arm, values: Mapping[Term, float], tolerances: Mapping[Term, float]) -> Arm:
    """The arm with effects beside those that it lists already; numbers stay in their ranges.

    It keeps its name: without its effects it is the nominal arm, and whatever was made for that
    one fits it.
    """
    counts = arm.segment_count, arm.cable_count
    listed = [*arm.effects, *_listed(values, *counts), *_listed(tolerances, *counts)]
    return arm.model_copy(update={"effects": listed})


def _listed(
    values: Mapping[Term, float], segment_count: int, cable_count: int
) -> list[ListedEffect]:
    """One entry for each effect and place, in the order in which they were found."""
    found = []
    for (name, place), terms in groupby(values, key=lambda term: (term.effect, term.place)):
        effect = known_effects()[name]
        every = (*effect.parameters, *effect.history(segment_count, cable_count))
        ranges = {p.name: (p.low, p.high) for p in every}
        numbers = {
            term.parameter: float(np.clip(values[term], *ranges[term.parameter])) for term in terms
        }
        found.append(ListedEffect(effect=name, at=place, parameters=numbers))
    return found


def write_arm(path: Path, arm: Arm, heading: str) -> None:
    """Write an arm file that reads back as this very arm, `heading` as comment lines above."""
    content = arm.model_dump(mode="python", exclude_none=True)
    for effect in content["effects"]:
        if effect["at"] == WHOLE_ARM:
            del effect["at"]
    lines = "".join(f"# {line}\n" for line in heading.splitlines())
    text = lines + yaml.safe_dump(_plain(content), sort_keys=False, width=99)
    parse_arm(text, source=str(path))
    path.write_text(text, encoding="utf-8")


def _plain(value: object) -> object:
    """Tuples as lists, which YAML knows."""
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return value
