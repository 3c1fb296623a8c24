"""The verdict as text and bars: its headline, effects, places, numbers, and parts of the gap.

`charts.html` has the macros that draw the bars; every template can import it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from typing import Any, Literal, NamedTuple

from cablesense_gap.diagnosis.probability import NEAR_BEST
from cablesense_gap.report.style import newtons, percent, size_text, with_interval
from cablesense_gap.verdict import (
    CANNOT_TELL,
    DECIDING_ERROR,
    NONE,
    UNKNOWN,
    CandidateResult,
    Earlier,
    EstimatorErrors,
    FittedNumber,
    Verdict,
    joined,
    listed,
)
from cablesense_sim.arm import Arm
from cablesense_sim.effects.effect import EffectDescription, Parameter
from cablesense_sim.effects.registry import known_effects

SURE = 0.9
"""A verdict of at least this probability is stated without `probably`."""
PROBABLE = 0.5
"""A verdict is called probable above this, and otherwise one of several that are likely."""
_MOST_KEPT = 3
"""Channels whose remaining gaps stand in a sentence one by one."""
_PAYLOAD = "payload"
_MOST_CHANNELS = 3
"""That a headline names."""
_MOST_NUMBERS = 4
"""That a terminal shows of a verdict."""
_COUNTS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")

_PREPOSITIONS = {"cable": "at", "segment": "on", "joint": "in"}
_PLACE = re.compile(r"(cable|segment|joint)_(\d+)")


def headline(verdict: Verdict) -> str:
    """The first line: what, where, how sure."""
    sure = _how_sure(verdict)
    gap = size_text(verdict.gap.before_n, verdict.unit)
    since = " since the reference" if verdict.reference else ""
    if verdict.effects == (NONE,):
        if since:
            return (
                f"Nothing changed{since}: the gap of {gap} is what its model leaves of the "
                f"healthy machine ({sure})."
            )
        return (
            f"Nothing to add: the gap of {gap} is what noise and manufacturing tolerances leave "
            f"({sure})."
        )
    if verdict.effects == (CANNOT_TELL,):
        return (
            f"Cannot tell whether anything changed{since}, which covers {_uncovered(verdict)}: "
            "record this motion when healthy."
        )
    if verdict.effects == (UNKNOWN,):
        where = "" if verdict.of_robot else _at(verdict.where.places)
        return (
            f"Something that no known effect explains makes a gap of {gap}{where}{since} ({sure})."
        )
    if verdict.unlisted is not None:
        whole = f"what changed{since}" if since else "the gap"
        beside = unlisted_text(verdict)
        return f"Part of {whole} {_causes(verdict)}; {beside}."
    what = f"What changed{since}" if since else "The gap"
    if len(verdict.effects) == 1:
        (name,) = verdict.effects
        return f"{what} {_comes(verdict.probability)} from {cause(verdict, name)} ({sure})."
    return f"{what} {_causes(verdict)}; together they are {sure}."


def size_lines(verdict: Verdict) -> list[str]:
    """How large the named effects are, and what they leave of the gap; none of no effect."""
    if not verdict.parameters:
        return []
    lines = [
        _number_line(name, estimate)
        for name, estimate in islice(verdict.parameters.items(), _MOST_NUMBERS)
    ]
    further = len(verdict.parameters) - _MOST_NUMBERS
    if further > 0:
        lines.append(f"  and {further} more in the report")
    gap = verdict.gap
    after_n = gap.after_n if gap.effects_n is None else gap.effects_n
    before = size_text(gap.before_n, verdict.unit)
    after = size_text(after_n, verdict.unit)
    lines.append(
        f"With that, the gap of trials that were not fitted falls from {before} to {after}."
    )
    return lines


def _number_line(name: str, estimate: FittedNumber) -> str:
    value, interval = with_interval(estimate)
    return f"  {name}: {_with_unit(value, estimate)} ({interval})"


def unlisted_text(verdict: Verdict) -> str:
    """What acts beside the named effects, by channel in its unit and per cent.

    Empty where nothing does.
    """
    unlisted = verdict.unlisted
    if unlisted is None:
        return ""
    texts = []
    if unlisted.trials:
        numbers = listed([str(trial) for trial in unlisted.trials])
        trials = f"trial{'s' if len(unlisted.trials) > 1 else ''} {numbers}"
        gap = "" if unlisted.after_n is None else f" of {_left(unlisted.after_n, verdict)}"
        texts.append(f"in {trials} nothing in the list explains a gap{gap}")
    if unlisted.channels:
        texts.append(f"{_kept(verdict, unlisted.channels)}, which nothing in the list explains")
    if not texts:
        sure = percent(unlisted.probability)
        texts.append(f"something that no known effect explains acts as well ({sure})")
    return ", and ".join(texts)


def removed_by_channel(verdict: Verdict) -> str:
    """`: 94 % of what can be removed at joint_2, down to 3 % at joint_5`; empty without channels.

    The channels with a gap count, so that one with a small floor does not speak for all.
    """
    removed = {
        name: gap.removed_fraction
        for name, gap in verdict.channels.items()
        if gap.removed_fraction is not None and gap.before > gap.floor
    }
    if not removed:
        return ""
    most, least = (pick(removed, key=lambda name: removed[name]) for pick in (max, min))
    high, low = percent(max(removed[most], 0.0)), percent(max(removed[least], 0.0))
    if high == low:
        return f": {high} of what can be removed in every channel with a gap"
    return f": {high} of what can be removed at {most}, down to {low} at {least}"


def _left(size: float, verdict: Verdict) -> str:
    return size_text(size, verdict.unit)


def _kept(verdict: Verdict, names: tuple[str, ...]) -> str:
    """`joint_3 and joint_5 keep 1.2 and 0.8 N·m, 82 and 70 % of their gaps`."""
    gaps = [verdict.channels[name] for name in names]
    shares = [gap.kept for gap in gaps]
    kind = "cables" if not verdict.of_robot else "channels"
    if len(names) > _MOST_KEPT:
        low, high = percent(min(shares)), percent(max(shares))
        between = low if low == high else f"{low.removesuffix(' %')} to {high}"
        return f"{len(names)} of {len(verdict.channels)} {kind} keep {between} of their gaps"
    plain = [name if verdict.of_robot else name.replace("_", " ") for name in names]
    sizes = [f"{gap.after:.2g} {gap.unit}" for gap in gaps]
    kept = listed([percent(share) for share in shares])
    if len(names) == 1:
        return f"{plain[0]} keeps {sizes[0]}, {kept} of its gap"
    return f"{listed(plain)} keep {listed(sizes)}, {kept} of their gaps"


def _uncovered(verdict: Verdict) -> str:
    """`7 % of shoulder and 12 % of elbow`: the channels that are mostly not covered."""
    assert verdict.reference is not None
    uncovered = verdict.reference.uncovered_channels
    if len(uncovered) > _MOST_CHANNELS:
        most = max(each.share for each in uncovered.values())
        return f"at most {percent(most)} of {len(uncovered)} channels"
    return listed(
        [f"{percent(each.share)} of {_channel(verdict, name)}" for name, each in uncovered.items()]
    )


def _channel(verdict: Verdict, name: str) -> str:
    """Joints keep their model's names."""
    return name if verdict.of_robot else name.replace("_", " ")


def coverage_sentence(verdict: Verdict) -> str:
    """How much of the recording the reference covers; empty where all is, or without one."""
    reference = verdict.reference
    if reference is None or reference.covered_share is None or reference.covered_share == 1.0:
        return ""
    least = min(reference.coverage, key=lambda name: reference.coverage[name].share)
    share = reference.coverage[least].share
    return (
        f"The reference covers {percent(reference.covered_share)} of the readings by their "
        f"positions, speeds and loads ({percent(share)} of {_channel(verdict, least)}); the "
        "verdict is of these alone."
    )


def _comes(probability: float) -> str:
    if probability >= SURE:
        return "comes"
    return "probably comes" if probability > PROBABLE else "may come"


def _causes(verdict: Verdict) -> str:
    """What each of several effects is to the gap, the most probable first, with its own doubt.

    An effect is there if any hypothesis with it is true, so each is at least as probable as all of
    them together.
    """
    probabilities = {
        name: share.probability for name, share in verdict.shares.items()
    } or dict.fromkeys(verdict.effects, verdict.probability)
    by_phrase: dict[str, list[str]] = {}
    for name in sorted(verdict.effects, key=lambda name: -probabilities[name]):
        doubt = f"{cause(verdict, name)} ({percent(probabilities[name])})"
        by_phrase.setdefault(_comes(probabilities[name]), []).append(doubt)
    return ", and ".join(
        f"{comes} from {', and from '.join(causes)}" for comes, causes in by_phrase.items()
    )


def _how_sure(verdict: Verdict) -> str:
    """`93 % sure`, or `most likely of three, 37 %` where all others together are likelier."""
    probability = verdict.probability
    if probability > PROBABLE:
        return f"{percent(probability)} sure"
    near = [p for c in verdict.candidates if (p := c.probability) >= NEAR_BEST * probability]
    rank = "most likely" if max(near, default=0.0) <= probability else "one"
    among = f" of {_COUNTS[len(near)]}" if 1 < len(near) < len(_COUNTS) else ""
    return f"{rank}{among}, {percent(probability)}"


_OUTCOMES = {
    "stands": "confirmed, with about the same numbers",
    "changed": "confirmed, with other numbers",
    "not needed": "no longer needed: held-out trials are predicted as well without it",
}


def earlier_sentence(earlier: Earlier, *, of_robot: bool = False) -> str:
    """Whether an effect that the arm file, or the amended model, listed is confirmed."""
    whose = "amended model" if of_robot else "arm file"
    places = f" at {listed(list(earlier.places))}" if earlier.places else ""
    name = earlier.effect.replace("_", " ") + (places if of_robot else _at(earlier.places))
    numbers = [
        f"{key} {_with_unit(f'{estimate.value:.3g}', estimate)} (was {earlier.was[key]:.3g})"
        for key, estimate in earlier.now.items()
    ]
    after = f": {', '.join(numbers)}" if numbers and earlier.outcome == "changed" else ""
    return f"The {whose}'s {name} is {_OUTCOMES[earlier.outcome]}{after}."


FRICTION_HIDES = (
    "Friction of cables hides forces from any estimator at rest: let the arm breathe "
    "(docs/breathing.md)."
)
"""Added to errors of estimators if a verdict names that friction."""

_ERRORS: dict[str, tuple[str, Callable[[float], str]]] = {
    DECIDING_ERROR: ("force stated wrongly or missed, mean: this decides", newtons),
    "contact_accuracy": ("loaded segment named", percent),
    "force_mae_n": ("force off by, mean", newtons),
    "direction_mean_deg": ("direction off by, mean", lambda value: f"{value:.2f}°"),
    "interval_coverage": ("force within the stated 95 % interval", percent),
    "false_force_n": ("force estimated on the released arm, mean", newtons),
}


def error_rows(estimator: EstimatorErrors) -> list[tuple[str, str, str]]:
    """Errors of the first and of the second estimator by name; dashes if there are none."""
    rows = []
    for name in dict(estimator.before, **(estimator.after or {})):
        label, text = _ERRORS.get(name, (name.replace("_", " "), "{:.4g}".format))
        cells = [
            text(errors[name]) if errors and name in errors else "–"
            for errors in (estimator.before, estimator.after)
        ]
        rows.append((label, cells[0], cells[1]))
    return rows


def _known(verdict: Verdict) -> Mapping[str, EffectDescription]:
    """Effects of its kind of machine; those not installed here keep their names in a report."""
    if not verdict.of_robot:
        return known_effects()
    from cablesense_gap.robot import amending  # loads MuJoCo

    return amending.known_robot_effects()


def cause(verdict: Verdict, name: str) -> str:
    """An effect in plain text with its places."""
    effect = _known(verdict).get(name)
    about = effect.about if effect else name.replace("_", " ")
    places = effect_places(verdict, name)
    if not verdict.of_robot:
        return about + _at(places)
    if name == _PAYLOAD and (loads := _loads(verdict, places)):
        return listed(loads)
    named = listed([place.replace("_into_", " into ") for place in places])
    return f"{about} at {named}{_law_text(verdict, name, places)}" if places else about


_NAMED_LAWS = ("Coulomb", "Dahl", "Stribeck", "LuGre")


def _law_text(verdict: Verdict, name: str, places: Sequence[str]) -> str:
    """The model of dry friction as the end of a phrase, if held-out trials tell it."""
    known = [verdict.forms[place] for place in places if place in verdict.forms]
    if name != "joint_friction" or not known:
        return ""
    if not all(form.determined for form in known):
        return ", whose form is not determined"
    laws = [law for law in _NAMED_LAWS if any(form.law.startswith(law) for form in known)]
    models = "model" if len(laws) == 1 else "models"
    return f" by the {listed(laws)} {models}" if laws else ""


def _loads(verdict: Verdict, bodies: tuple[str, ...]) -> list[str]:
    """`2.0 kg taken off at lower, 0.1 m from its centre of mass`, by body; none if not known."""
    texts = []
    for body in bodies:
        named_places = f"{_PAYLOAD}.{body}.mass_kg" in verdict.parameters
        prefix = f"{_PAYLOAD}.{body}" if named_places else _PAYLOAD
        numbers = [f"{prefix}.mass_kg", *(f"{prefix}.place_{axis}_m" for axis in "xyz")]
        if not set(numbers) <= set(verdict.parameters):
            return []
        mass_kg, *place_m = (verdict.parameters[number].value for number in numbers)
        what = "taken off" if mass_kg < 0.0 else "added"
        if not verdict.reference:
            what = "that nobody modelled"
        texts.append(
            f"{abs(mass_kg):.2g} kg {what} at {body}, {math.hypot(*place_m):.2g} m from its "
            "centre of mass"
        )
    return texts


def causes_and_advice(verdict: Verdict) -> list[tuple[str, str]]:
    """Each effect in plain text, and what someone at the machine can do about it, if anything."""
    known = _known(verdict)
    return [
        (cause(verdict, name), known[name].advice if name in known else "")
        for name in verdict.effects
    ]


def rival_names(verdict: Verdict) -> list[str]:
    """Hypotheses that the recording cannot distinguish from the verdict's."""
    others = [name for name in verdict.ambiguity_group if name != joined(verdict.effects)]
    return [candidate_name(name.split("+")) for name in others]


def effect_places(verdict: Verdict, effect: str) -> tuple[str, ...]:
    """Places of an effect of the verdict; empty for the whole arm or robot."""
    if verdict.of_robot:
        return verdict.shares[effect].places if effect in verdict.shares else ()
    names = [name.split(".") for name in verdict.parameters]
    middles = [middle for name, *middle, _ in names if name == effect]
    places = [m.group() for middle in middles for m in _PLACE.finditer(" ".join(middle))]
    if not places and len(verdict.effects) == 1:
        places = list(verdict.where.places)
    return tuple(dict.fromkeys(places))


class ExplainedNumber(NamedTuple):
    """A fitted number as the report has it, all as text.

    Attributes:
        about: what the number means; empty for an effect that is not installed here.
        past: whether it is the friction or creep state at the start of this recording.
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
    explained = []
    for name, estimate in sorted(
        verdict.parameters.items(), key=lambda item: item[0].partition(".")[0]
    ):
        effect_name, *place, parameter_name = name.split(".")
        effect = known_effects().get(effect_name)
        known = None
        if effect:
            parameters = [*effect.parameters, *effect.history(arm.segment_count, arm.cable_count)]
            parameters += [effect.product] if effect.product else []
            known = next((p for p in parameters if p.name == parameter_name), None)
        value, interval = _known_within(estimate, known)
        explained.append(
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
    return explained


def _with_unit(value: str, estimate: FittedNumber) -> str:
    return value if estimate.unit == "1" else f"{value} {estimate.unit}"


def _known_within(estimate: FittedNumber, parameter: Parameter | None) -> tuple[str, str]:
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
        f"{_PREPOSITIONS[kind]} {kind}{'s' if len(kind_numbers) > 1 else ''} "
        f"{listed([str(n) for n in sorted(kind_numbers)])}"
        for kind, kind_numbers in numbers.items()
    )


def _at(places: tuple[str, ...]) -> str:
    return f", {place_text(places)}" if places else ""


def candidate_name(effects: tuple[str, ...] | list[str], *, unlisted: bool = False) -> str:
    """`payload + base tilt`, as pictures and lists call a candidate.

    Where something `unlisted` acts beside these effects, it is the last of them.
    """
    names = [name.replace("_", " ") for name in effects]
    if unlisted:
        names.append("something unlisted")
    return " + ".join(names)


def named_candidates(verdict: Verdict) -> list[tuple[str, CandidateResult]]:
    """All candidates with their names, the most probable first."""
    return [
        (candidate_name(each.effects, unlisted=each.unlisted), each) for each in verdict.ranked
    ]


_Kind = Literal["before", "after", "other", "floor"]


class Bar(NamedTuple):
    """One bar, from `low` to `high` in the verdict's unit, with a text."""

    name: str
    low: float
    high: float
    kind: _Kind
    text: str


def gap_bars(verdict: Verdict) -> list[Bar]:
    """The nominal gap, that with the effects alone, that with tolerances too, and the floor."""
    gap = verdict.gap
    sizes: list[tuple[str, float, _Kind]] = [("nominal", gap.before_n, "before")]
    if gap.effects_n is not None:
        effects = listed([candidate_name((name,)) for name in verdict.effects])
        sizes.append((f"with {effects} alone", gap.effects_n, "after"))
        sizes.append(("with tolerances as well", gap.after_n, "after"))
    elif verdict.effects == (UNKNOWN,) and not verdict.of_robot:
        sizes.append(("with a flexible correction", gap.after_n, "other"))
    else:
        sizes.append(("with tolerances as fitted", gap.after_n, "other"))
    sizes.append((_floor_name(verdict), gap.floor_n, "floor"))
    return [Bar(name, 0.0, n, kind, size_text(n, verdict.unit)) for name, n, kind in sizes]


def steps(verdict: Verdict) -> list[Bar]:
    """Steps from the nominal gap down to the floor, one for each of several effects."""
    if len(verdict.shares) < 2:
        return []
    gap = verdict.gap
    unit = verdict.unit
    level = verdict.gap.before_n
    bars = [Bar("nominal", 0.0, level, "before", size_text(level, unit))]
    ends: list[tuple[str, float, _Kind]] = [
        (candidate_name((name,)), share.left_n, "after") for name, share in verdict.shares.items()
    ]
    ends += [
        ("tolerances", gap.after_n, "other"),
        ("unexplained", min(gap.floor_n, gap.after_n), "other"),
    ]
    for name, level_after, kind in ends:
        low, high = sorted((level, level_after))
        bars.append(Bar(name, low, high, kind, _signed(level_after - level, unit)))
        level = level_after
    floor = size_text(gap.floor_n, unit)
    return [*bars, Bar(_floor_name(verdict), 0.0, gap.floor_n, "floor", floor)]


def _floor_name(verdict: Verdict) -> str:
    """Sensors alone make one floor where that is the unit; more is a model that is not exact."""
    if verdict.reference:
        return "healthy machine"
    exact = verdict.unit != "floors" or verdict.gap.floor_n == 1.0
    return "sensors alone" if exact else "model error as usual"


def _signed(change: float, unit: str) -> str:
    size = size_text(abs(change), unit)
    return size if change >= 0.0 or size == size_text(0.0, unit) else f"\N{MINUS SIGN}{size}"


def common_content(verdict: Verdict) -> dict[str, Any]:
    """What `layout.html` and the budget show."""
    alone = verdict.effects[0] in (NONE, UNKNOWN, CANNOT_TELL)
    return {
        "kind": verdict.effects[0] if alone else "effect",
        "headline": headline(verdict),
        "coverage": coverage_sentence(verdict),
        "rivals": rival_names(verdict),
        "causes": [] if alone else causes_and_advice(verdict),
        "verdict": verdict,
        "candidates": named_candidates(verdict),
        "bars": gap_bars(verdict),
        "removed_by_channel": removed_by_channel(verdict),
        "steps": steps(verdict),
    }
