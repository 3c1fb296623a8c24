"""Every effect of a robot, and what a list of them makes of it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import groupby
from types import MappingProxyType

from cablesense_gap.robot import effects
from cablesense_gap.robot.effects.effect import PRESLIDING, RobotEffect, Scale
from cablesense_gap.robot.model import Change, Robot
from cablesense_gap.simulator import Assignment, Candidate, Term
from cablesense_sim.effects.registry import effects_in


@cache
def known_effects() -> Mapping[str, RobotEffect]:
    """Effects by name, tolerances included: those of the folder `effects`."""
    return MappingProxyType(dict(sorted(effects_in(effects, RobotEffect).items())))


def candidate(effect: RobotEffect, robot: Robot, scale: Scale) -> Candidate:
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
