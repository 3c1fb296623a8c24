"""The verdict in one plain sentence, and the names of what it names."""

from __future__ import annotations

import re

from cablesense_gap.report.style import newtons, percent
from cablesense_gap.verdict import NONE, UNKNOWN, Verdict, listed
from cablesense_sim.effects.registry import known_effects

SURE = 0.9
"""From this probability on, a verdict is stated without `probably`."""

_PREPOSITIONS = {"cable": "at", "segment": "on", "joint": "in"}
_PLACE = re.compile(r"(cable|segment|joint)_(\d+)")


def headline(verdict: Verdict) -> str:
    """The first line: what, where, how sure."""
    sure, gap = percent(verdict.probability), verdict.gap
    if verdict.effects == (NONE,):
        return (
            f"Nothing to add: the gap of {newtons(gap.before_n)} is what noise and "
            f"manufacturing tolerances leave ({sure} sure)."
        )
    if verdict.effects == (UNKNOWN,):
        return (
            f"Something that no known effect explains makes a gap of {newtons(gap.before_n)}"
            f"{_at(verdict.where.places)} ({sure} sure)."
        )
    causes = ", and from ".join(cause(verdict, name) for name in verdict.effects)
    probably = "" if verdict.probability >= SURE else " probably"
    return f"The gap{probably} comes from {causes} ({sure} sure)."


def cause(verdict: Verdict, name: str) -> str:
    """An effect in plain text with its places; one that is not installed here keeps its name."""
    effect = known_effects().get(name)
    about = effect.about if effect else name.replace("_", " ")
    return about + _at(effect_places(verdict, name))


def effect_advice(name: str) -> str:
    """What someone at the arm can do about it; may be empty."""
    effect = known_effects().get(name)
    return effect.advice if effect else ""


def effect_places(verdict: Verdict, effect: str) -> tuple[str, ...]:
    """Where an effect of the verdict sits; empty for the whole arm."""
    names = [name.split(".") for name in verdict.parameters]
    middles = [middle for name, *middle, _ in names if name == effect]
    found = [m.group() for middle in middles for m in _PLACE.finditer(" ".join(middle))]
    if not found and len(verdict.effects) == 1:
        found = list(verdict.where.places)
    return tuple(dict.fromkeys(found))


def place_text(places: tuple[str, ...]) -> str:
    """`at cables 3 and 5, on segment 2`."""
    numbers: dict[str, list[int]] = {}
    for place in places:
        kind, _, number = place.rpartition("_")
        numbers.setdefault(kind, []).append(int(number))
    return ", ".join(
        f"{_PREPOSITIONS[kind]} {kind}{'s' if len(found) > 1 else ''} "
        f"{listed([str(n) for n in sorted(found)])}"
        for kind, found in numbers.items()
    )


def _at(places: tuple[str, ...]) -> str:
    return f", {place_text(places)}" if places else ""


def candidate_name(effects: tuple[str, ...] | list[str]) -> str:
    """`payload + base tilt`, as pictures and lists call a candidate."""
    return " + ".join(name.replace("_", " ") for name in effects)
