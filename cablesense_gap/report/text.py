"""The verdict in one plain sentence, and the names of what it names."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple

from cablesense_gap.report.style import newtons, percent, with_interval
from cablesense_gap.verdict import NONE, UNKNOWN, Earlier, Estimate, Estimator, Verdict, listed
from cablesense_sim.arm import Arm
from cablesense_sim.effects.effect import Parameter
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


_OUTCOMES = {
    "stands": "still borne out, with about the same numbers",
    "changed": "still borne out, with other numbers",
    "not needed": "no longer needed: held-out trials are predicted as well without it",
}


def earlier_sentence(earlier: Earlier) -> str:
    """What of one effect that the arm file listed still stands."""
    name = earlier.effect.replace("_", " ") + _at(earlier.places)
    numbers = [
        f"{key} {_with_unit(f'{estimate.value:.3g}', estimate)} (was {earlier.was[key]:.3g})"
        for key, estimate in earlier.now.items()
    ]
    after = f": {', '.join(numbers)}" if numbers and earlier.outcome == "changed" else ""
    return f"The arm file's {name} is {_OUTCOMES[earlier.outcome]}{after}."


FRICTION_HIDES = (
    "Friction of cables hides forces from any estimator at rest: let the arm breathe "
    "(docs/breathing.md)."
)
"""Beside errors of estimators where a verdict names that friction."""

_ERRORS: dict[str, tuple[str, Callable[[float], str]]] = {
    "contact_accuracy": ("loaded segment named", percent),
    "force_mae_n": ("force off by, mean", newtons),
    "direction_mean_deg": ("direction off by, mean", lambda value: f"{value:.2f}°"),
    "interval_coverage": ("force within the stated 95 % interval", percent),
    "false_force_n": ("force estimated on the released arm, mean", newtons),
}


def error_rows(estimator: Estimator) -> list[tuple[str, str, str]]:
    """Errors of the first and of the second estimator, by what they are; dashes where none."""
    found = []
    for name in dict(estimator.before, **(estimator.after or {})):
        label, text = _ERRORS.get(name, (name.replace("_", " "), "{:.4g}".format))
        cells = [
            text(errors[name]) if errors and name in errors else "–"
            for errors in (estimator.before, estimator.after)
        ]
        found.append((label, cells[0], cells[1]))
    return found


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


class ExplainedNumber(NamedTuple):
    """A fitted number as the report has it, all as text.

    Attributes:
        about: what the number means; empty for an effect that is not installed here.
        past: whether it is what the past had left, and so this recording's own.
    """

    effect: str
    place: str
    parameter: str
    about: str
    value: str
    interval: str
    past: bool


def numbers(verdict: Verdict, arm: Arm) -> list[ExplainedNumber]:
    """Every number of a verdict on an arm, explained, effect by effect."""
    found = []
    for name, estimate in sorted(
        verdict.parameters.items(), key=lambda item: item[0].partition(".")[0]
    ):
        effect_name, *place, parameter_name = name.split(".")
        effect, known = known_effects().get(effect_name), None
        if effect:
            every = (*effect.parameters, *effect.history(arm.segment_count, arm.cable_count))
            known = next((p for p in every if p.name == parameter_name), None)
        value, interval = _known_within(estimate, known)
        found.append(
            ExplainedNumber(
                effect_name.replace("_", " "),
                " ".join(place or effect_places(verdict, effect_name)).replace("_", " "),
                parameter_name,
                known.about if known else "",
                _with_unit(value, estimate),
                interval,
                bool(known and known.past),
            )
        )
    return found


def _with_unit(value: str, estimate: Estimate) -> str:
    return value if estimate.unit == "1" else f"{value} {estimate.unit}"


def _known_within(estimate: Estimate, parameter: Parameter | None) -> tuple[str, str]:
    """Value and interval; of a number at an end of its range only the other side is known."""
    value, interval = with_interval(estimate)
    if parameter is None or parameter.low < estimate.value < parameter.high:
        return value, interval
    low, high = interval.split(" to ")
    if tuple(estimate.ci95) == (parameter.low, parameter.high):
        return value, "anywhere in its range"
    side = f"at most {high}" if estimate.value <= parameter.low else f"at least {low}"
    return value, f"{side}; its range ends at {value}"


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
