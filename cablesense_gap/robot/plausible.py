"""How plausible an explanation of a robot is: by its tolerances, sizes and places."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from cablesense_base import Array
from cablesense_gap.diagnosis.problem import Explanation, Problem
from cablesense_gap.robot.model import Change, Robot
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import Gap
from cablesense_sim.effects.effect import Parameter

_FAR_OFF = 3.0
"""Standard deviations that one tolerance among many may be off."""
_FURTHER = 0.5
"""Each number in a further place of an effect costs this, natural logarithm."""
_FAR_BEYOND, _LITTLE = 10.0, 0.5
"""Times the model's own value, and removed share of the gap, that make a verdict doubtful."""


def weighed(problem: Problem, explanation: Explanation) -> Explanation:
    """The explanation, with what its tolerances, sizes and places cost.

    One tolerance far off counts as much as all of them off. A robot has dozens of tolerances. A
    single one, for example a delay of many samples, would not show in the sum of their squares.
    """
    std = dict(zip(problem.tolerance_terms, problem.tolerance_std, strict=True))
    tolerances = explanation.tolerances
    largest = max((abs(value) / std[term] for term, value in tolerances.items()), default=0.0)
    least = len(tolerances) * (largest / _FAR_OFF) ** 4
    return replace(
        explanation,
        tolerance_chi2=max(explanation.tolerance_chi2, least),
        surprise=_surprise(problem, explanation),
    )


def _surprise(problem: Problem, explanation: Explanation) -> float:
    """Sizes cost nothing within their expected range, and beyond it the same for each decade.

    The size that is surely farthest off counts for its site.
    """
    far: dict[tuple[str, str], list[float]] = {site: [] for site in explanation.sites}
    for term, value in explanation.values.items():
        parameter = problem.parameters[term]
        if parameter.role == "size":
            sure = max(abs(value) - explanation.deviations[term], 0.0)
            far[term[:2]].append(sure / (parameter.spread * parameter.typical))
    first = {site[0]: site for site in reversed(far)}
    numbers = sum(len(own) for site, own in far.items() if site != first[site[0]])
    return float(2.0 * sum(np.log(max(1.0, *own)) for own in far.values())) + _FURTHER * numbers


def at_bounds(ranges: Mapping[Term, Parameter], values: Mapping[Term, float]) -> Iterator[str]:
    """Sizes that end at their bounds, as sentences."""
    for term, value in values.items():
        bounds, name = (ranges[term].low, ranges[term].high), f"{term.effect} at {term.place}"
        if ranges[term].role == "size" and value and value in bounds:
            yield f"{name}: {term.parameter} ends at its bound of {value:.3g}."


def far_beyond(robot: Robot, change: Change, inertia: Array) -> Iterator[str]:
    """Masses and inertias far larger than the model's; `inertia` (J,) is what joints feel there.

    Dampers and friction of a model are often placeholders.
    """
    nominal = robot.nominal()
    mass, rotor = change.mass_kg - nominal.mass_kg, change.armature - nominal.armature
    for name, places, more, own in (
        ("mass", robot.bodies, mass, nominal.mass_kg),
        ("inertia", robot.joints, rotor, inertia),
    ):
        for k in np.flatnonzero(more > _FAR_BEYOND * own).tolist():
            yield f"The {name} of {places[k]} is {1.0 + more[k] / own[k]:.1f} times the model's."


def little_removed(gap: Gap) -> Iterator[str]:
    """That more than half of the gap stays."""
    if gap.removed_fraction < _LITTLE:
        yield f"The amended model leaves {1.0 - gap.removed_fraction:.0%} of the gap."
