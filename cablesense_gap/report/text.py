"""The verdict in plain sentences, and what to do next, for people who have never seen the tool."""

from __future__ import annotations

import re
from dataclasses import dataclass

from cablesense_gap.pipeline import Diagnosis
from cablesense_gap.report.style import newtons, percent
from cablesense_gap.residuals import EVERYWHERE
from cablesense_gap.verdict import NONE, UNKNOWN, Verdict, joined, listed
from cablesense_sim.effects.registry import known_effects


def effect_about(name: str) -> str:
    """What an effect is; one that is not installed here keeps its name."""
    effect = known_effects().get(name)
    return effect.about if effect else name.replace("_", " ")


def effect_advice(name: str) -> str:
    """What someone at the arm can do about it; may be empty."""
    effect = known_effects().get(name)
    return effect.advice if effect else ""


SURE = 0.9
"""From this probability on, a verdict is stated without `probably`."""

POOR_SHARE = 0.5
"""Where less of the gap is removed, an amended arm is not to be relied on."""

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
    """What this recording cannot distinguish from the verdict; empty where there is nothing."""
    others = [name for name in verdict.ambiguity_group if name != joined(verdict.effects)]
    if not others:
        return ""
    named = [candidate_name(tuple(name.split("+"))) for name in others]
    return f"This recording cannot distinguish it from {listed(named, 'or')}."


def cause(verdict: Verdict, effect: str) -> str:
    """An effect in plain text with its places."""
    return effect_about(effect) + _at(effect_places(verdict, effect))


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


def regime_text(verdict: Verdict) -> str:
    """A sentence on the regimes; empty where the verdict names none."""
    named = verdict.where.regimes
    if not named:
        return ""
    if named == (EVERYWHERE,):
        return "The gap is alike whatever the arm does."
    return f"The gap is clearly larger than elsewhere here: {', '.join(named)}."


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


def candidate_name(effects: tuple[str, ...]) -> str:
    """`payload + base tilt`, as pictures and lists call a candidate."""
    return " + ".join(name.replace("_", " ") for name in effects)


def _at(places: tuple[str, ...]) -> str:
    return f", {place_text(places)}" if places else ""


@dataclass(frozen=True)
class Step:
    """One thing to do: how and why, and commands to type."""

    title: str
    text: str
    commands: tuple[str, ...] = ()


def steps(found: Diagnosis) -> tuple[Step, ...]:
    """What to do about the verdict, the most urgent first."""
    verdict = found.verdict
    if verdict.effects == (NONE,):
        keep = Step(
            "Keep the nominal arm file",
            "No effect of the library earns a place in it. If an estimate is still poor, the "
            "cause is not the arm's simulation in the regimes that were recorded.",
        )
        return (keep, *_experiment(verdict, "To be surer"))
    if verdict.effects == (UNKNOWN,):
        return (
            *_experiment(verdict, "Narrow it down"),
            Step(
                "Do not amend the arm file",
                "The nominal arm is still the best that the library offers. The pictures below "
                "show in which cables and regimes the gap is; look at the arm there for friction, "
                "play, contact and loose parts.",
            ),
            Step(
                "If you know the physics, add it as an effect",
                "An effect is one Python file, in the package or in one of your own; diagnose "
                "again with it (docs/diagnosis.md).",
            ),
        )
    use = Step(
        "Use the amended arm file arm.yaml",
        f"It lies beside this page: arm {found.nominal.name} with the parameters of the table "
        "below. Check it on a recording that was not used here, train the estimator on it, and "
        "measure again.",
        (
            "cablesense gap predict NEW_RECORDING --arm arm.yaml --out predicted.csv",
            "cablesense train --arm arm.yaml --out amended.onnx",
        ),
    )
    mend = [
        Step(f"Or mend the arm: {cause(verdict, name)}", effect_advice(name))
        for name in verdict.effects
        if effect_advice(name)
    ]
    doubtful = verdict.probability < SURE or ambiguity(verdict) != ""
    if doubtful or verdict.gap.removed_fraction < POOR_SHARE:
        return (*_experiment(verdict, "First make sure"), use, *mend)
    return (use, *mend, *_experiment(verdict, "To be surer still"))


def _experiment(verdict: Verdict, title: str) -> tuple[Step, ...]:
    text = verdict.next_experiment
    if not text:
        return ()
    if verdict.effects not in ((NONE,), (UNKNOWN,)) and verdict.probability < SURE:
        elsewhere = percent(1.0 - verdict.probability)
        text += f" As it stands, {elsewhere} of the probability lies elsewhere."
    return (Step(title, text, ("cablesense gap record --out next.mcap",)),)
