"""The verdict in plain sentences."""

from __future__ import annotations

import re

from cablesense_gap.report.effect_words import effect_words
from cablesense_gap.report.numbers import listed, newtons, percent
from cablesense_gap.residuals.regimes import EVERYWHERE
from cablesense_gap.verdict import NONE, UNKNOWN, Verdict, joined

SURE = 0.9
"""From this probability on, a verdict is said without `probably`."""

_PREPOSITIONS = {"cable": "at", "segment": "on", "joint": "in"}
_PLACE = re.compile(r"(cable|segment|joint)_(\d+)")


def headline(verdict: Verdict) -> str:
    """The first line: what, where, how sure."""
    sure, gap = percent(verdict.probability), verdict.gap
    if verdict.effects == (NONE,):
        return (
            f"Nothing to add: the gap of {newtons(gap.before_n)} is what noise and a careful "
            f"workshop leave ({sure} sure)."
        )
    if verdict.effects == (UNKNOWN,):
        return (
            f"Something that no known effect explains makes a gap of {newtons(gap.before_n)}"
            f"{_at(all_places(verdict))} ({sure} sure)."
        )
    causes = ", and from ".join(cause(verdict, name) for name in verdict.effects)
    probably = "" if verdict.probability >= SURE else " probably"
    return f"The gap{probably} comes from {causes} ({sure} sure)."


def shrinkage(verdict: Verdict) -> str:
    """The second line: how far the gap shrinks."""
    gap = verdict.gap
    floor = f"noise and the sensors' step alone make {newtons(gap.floor_n)}"
    if verdict.effects == (NONE,):
        return f"In comparison, {floor}."
    unknown = verdict.effects == (UNKNOWN,)
    if gap.removed_fraction <= 0.0:
        if unknown:
            return f"No effect of the library shrinks it; {floor}."
        return (
            f"Simulating it does not shrink the gap of {newtons(gap.before_n)} on trials that the "
            f"fit has not seen; {floor}."
        )
    low, high = gap.ci95
    what = "A flexible correction, which knows no physics," if unknown else "Simulating it"
    return (
        f"{what} shrinks the gap from {newtons(gap.before_n)} to {newtons(gap.after_n)} on trials "
        f"that the fit has not seen: {percent(gap.removed_fraction)} of what can be removed "
        f"(95 % interval {percent(low)} to {percent(high)}); {floor}."
    )


def ambiguity(verdict: Verdict) -> str:
    """What this recording cannot tell from the verdict; empty where there is nothing."""
    others = [name for name in verdict.ambiguity_group if name != joined(verdict.effects)]
    if not others:
        return ""
    named = [candidate_name(tuple(name.split("+"))) for name in others]
    return f"This recording cannot tell it from {listed(named, 'or')}."


def cause(verdict: Verdict, effect: str) -> str:
    """An effect in words with its places."""
    return effect_words(effect).is_ + _at(effect_places(verdict, effect))


def effect_places(verdict: Verdict, effect: str) -> tuple[str, ...]:
    """Where an effect of the verdict sits; empty for the whole arm."""
    middles = [
        name.split(".")[1]
        for name in verdict.parameters
        if name.startswith(f"{effect}.") and name.count(".") > 1
    ]
    found = [match.group() for middle in middles for match in _PLACE.finditer(middle)]
    if not found and len(verdict.effects) == 1:
        found = list(all_places(verdict))
    return tuple(dict.fromkeys(found))


def all_places(verdict: Verdict) -> tuple[str, ...]:
    """Cables, segments and joints of the verdict."""
    return (*verdict.where.cables, *verdict.where.segments, *verdict.where.joints)


def regime_words(verdict: Verdict) -> str:
    """A sentence on the regimes; empty where the verdict names none."""
    named = verdict.where.regimes
    if not named:
        return ""
    if named == (EVERYWHERE,):
        return "The gap is alike whatever the arm does."
    return f"The gap is clearly larger than elsewhere here: {', '.join(named)}."


def place_words(places: tuple[str, ...]) -> str:
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


def candidate_name(effects: tuple[str, ...]) -> str:
    """`payload + base tilt`, as pictures and lists call a candidate."""
    return " + ".join(name.replace("_", " ") for name in effects)


def _at(places: tuple[str, ...]) -> str:
    return f", {place_words(places)}" if places else ""
