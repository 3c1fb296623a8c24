"""Which form the friction of a joint has: laws that are compared on held-out trials.

The laws are made of parts, and those with fewer parts are contained in those with more: Coulomb,
viscous, presliding (Dahl), a fall with the speed (Stribeck), both (LuGre), and in proportion to
the load. Six such laws for servo drives are compared in Duclusaud et al., Extended friction models
for the physics simulation of servo actuators, ICRA 2025.

The search works with plain forms (`richer` of an effect has the numbers beyond). Here hypotheses
get richer forms where held-out trials ask for them (`enriched`), and the verdict says which law
they ask for (`forms`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from cablesense_gap.diagnosis.fitting import MOST_STEPS, refine
from cablesense_gap.diagnosis.problem import Hypothesis, Problem, to_scaled
from cablesense_gap.robot.effects import LOPSIDED, PRESLIDING, SIDE, STRIBECK, STRIBECK_SPEED
from cablesense_gap.simulator import Candidate, Term
from cablesense_gap.verdict import FrictionForm
from cablesense_sim.effects.effect import Parameter

DRY = "joint_friction"
BY_LOAD = "load_friction"
VISCOUS = "viscous_friction"
FRICTION = (DRY, BY_LOAD, VISCOUS)
"""Effects that are friction of joints, in one form or another."""
_TORQUE_SCALE = "torque_scale"
_EXCHANGED = {BY_LOAD: _TORQUE_SCALE, _TORQUE_SCALE: BY_LOAD}
"""Effects that are one where loads always oppose the motion."""
_BEST_EXCHANGED = 2
"""Hypotheses in which these are exchanged: the best."""
_MOST_ENRICHED = 3
"""Hypotheses with friction that get richer forms: the best of the search, and their parts."""
_MOST_LOCATIONS = 6
"""Of friction in a hypothesis that gets richer forms: it would have two numbers more in each."""
_MOST_JOINTS = 3
"""Joints of a verdict whose laws are compared: the others are named without a form."""
_SPEED_FACTORS = (0.3, 1.0, 3.0)
_BEND_FACTORS = (1.0, 10.0)
"""By which Stribeck's speed and presliding are multiplied where fits begin: they are far from
linear."""


PART_OF: Mapping[str, str | None] = {
    "torque_n_m": "dry",
    "torque_s_n_m": "viscous",
    "share": "load",
    PRESLIDING: "presliding",
    STRIBECK: "Stribeck",
    STRIBECK_SPEED: None,
    LOPSIDED: "by direction",
    SIDE: None,
}
"""The part of a law that each number of `FRICTION` adds: None for the shape of another's part.

Laws are compared by their parts, so a number that has none stated is an error.
"""


@dataclass(frozen=True)
class Law:
    """A law of friction: its parts, and the numbers that it has of each effect."""

    name: str
    parts: frozenset[str]
    numbers: Mapping[str, tuple[str, ...]]


def _law(name: str, **numbers: tuple[str, ...]) -> Law:
    """A law by the numbers that it has of each effect; the parts follow.

    Raises:
        KeyError: `PART_OF` lacks a number.
    """
    parts = {PART_OF[number] for group in numbers.values() for number in group}
    return Law(name, frozenset(part for part in parts if part is not None), numbers)


_DRY_NUMBERS = ("torque_n_m",)
_FALL_NUMBERS = (STRIBECK, STRIBECK_SPEED)
_LOSS_NUMBERS = ("share", SIDE)
_ALWAYS_NUMBERS = {DRY: (PRESLIDING,), BY_LOAD: (PRESLIDING,)}
"""Numbers that an effect has in every law, where the comparison has them: forward in time dry
friction is MuJoCo's, which gives no way."""
_VISCOUS_NUMBERS = {"viscous_friction": ("torque_s_n_m",)}
LAWS = (
    _law("Coulomb", joint_friction=_DRY_NUMBERS),
    _law("viscous", **_VISCOUS_NUMBERS),
    _law("viscous, by direction", viscous_friction=("torque_s_n_m", LOPSIDED)),
    _law("Dahl", joint_friction=(*_DRY_NUMBERS, PRESLIDING)),
    _law("Stribeck", joint_friction=(*_DRY_NUMBERS, *_FALL_NUMBERS)),
    _law("LuGre", joint_friction=(*_DRY_NUMBERS, PRESLIDING, *_FALL_NUMBERS)),
    _law("by the load", load_friction=_LOSS_NUMBERS),
    _law("by the load, with presliding", load_friction=(*_LOSS_NUMBERS, PRESLIDING)),
    _law("by the load, with Stribeck", load_friction=(*_LOSS_NUMBERS, PRESLIDING, *_FALL_NUMBERS)),
)
"""All that are compared; each but the viscous ones may have viscous friction in addition."""


def with_imitators(problem: Problem, found: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The hypotheses, and the best with friction by the load exchanged for a torque constant.

    Where loads always oppose the motion, or always help it, the two are one. The search keeps one
    of effects that are so alike; a verdict is to name both.
    """
    candidates = {c.effect: c for c in problem.simulator.candidates}
    if not _EXCHANGED.keys() <= candidates.keys():
        return list(found)
    by_effects = {hypothesis.effects: hypothesis for hypothesis in found}
    for hypothesis in sorted(found, key=problem.score)[:_BEST_EXCHANGED]:
        for one, other in _EXCHANGED.items():
            places = [place for effect, place in hypothesis.locations if effect == one]
            if other in hypothesis.effects or not places:
                continue
            if not set(places) <= set(candidates[other].places):
                continue
            values = {t: value for t, value in hypothesis.values.items() if t.effect != one}
            for place in places:
                for parameter in candidates[other].parameters:
                    usual = parameter.typical if parameter.role == "size" else parameter.default
                    values[Term(other, place, parameter.name)] = usual
            fitted = _fitted_from(problem, values)
            known = by_effects.get(() if fitted is None else fitted.effects)
            if fitted is not None and (
                known is None or problem.score(fitted) < problem.score(known)
            ):
                by_effects[fitted.effects] = fitted
    return list(by_effects.values())


def enriched(problem: Problem, found: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The hypotheses; the best with friction have richer forms where held-out trials show them.

    Parts of these are tried alike: what a plain form left, another effect may have explained.
    Where a hypothesis leaves nothing to explain, all stay as they are.
    """
    if any(problem.is_explained(hypothesis) for hypothesis in found):
        return list(found)
    candidates = {c.effect: c for c in problem.simulator.candidates}
    by_effects = {hypothesis.effects: hypothesis for hypothesis in found}
    richer: list[Hypothesis] = []
    for effects, values in _worth_enriching(problem, found, candidates).items():
        plain = by_effects.get(effects)
        fitted = _screened(problem, values)
        if fitted is not None and (plain is None or problem.shows(fitted, plain)):
            by_effects[effects] = fitted
            richer.append(fitted)
    if richer:
        best = min(richer, key=problem.score)
        again = _fitted_from(problem, best.values)
        if again is not None and again.held_out_rmse < best.held_out_rmse:
            by_effects[best.effects] = again
    return list(by_effects.values())


def _worth_enriching(
    problem: Problem, found: Sequence[Hypothesis], candidates: Mapping[str, Candidate]
) -> dict[tuple[str, ...], dict[Term, float]]:
    """Values with the numbers of richer forms by effects: of the best, and of their parts."""
    with_friction = [h for h in found if _friction_of(h.values, candidates)]
    best = sorted(with_friction, key=problem.score)[:_MOST_ENRICHED]
    alone = [h for h in with_friction if len(h.effects) == 1]
    worth: dict[tuple[str, ...], dict[Term, float]] = {}
    for hypothesis in [*best, *alone]:
        for kept in _parts(hypothesis):
            values = {t: v for t, v in hypothesis.values.items() if t.effect in kept}
            count = len(_friction_of(values, candidates))
            if kept not in worth and 0 < count <= _MOST_LOCATIONS:
                worth[kept] = _with_richer(values, candidates)
    return worth


def _parts(hypothesis: Hypothesis) -> Iterator[tuple[str, ...]]:
    """Effects of the hypothesis, the same without each one, and those of friction alone."""
    yield hypothesis.effects
    for left_out in hypothesis.effects:
        yield tuple(effect for effect in hypothesis.effects if effect != left_out)
    yield tuple(effect for effect in hypothesis.effects if effect in FRICTION)


def _friction_of(
    values: Mapping[Term, float], candidates: Mapping[str, Candidate]
) -> list[tuple[str, str]]:
    """Locations of effects that have a richer form."""
    locations = dict.fromkeys(term[:2] for term in values)
    return [(effect, place) for effect, place in locations if candidates[effect].richer]


def _with_richer(
    values: Mapping[Term, float], candidates: Mapping[str, Candidate]
) -> dict[Term, float]:
    whole = dict(values)
    for effect, place in _friction_of(values, candidates):
        for parameter in candidates[effect].richer:
            start = parameter.typical if parameter.role == "size" else parameter.default
            whole.setdefault(Term(effect, place, parameter.name), start)
    return whole


def _screened(problem: Problem, values: Mapping[Term, float]) -> Hypothesis | None:
    """The values fitted, from the best of several shapes that all places have alike."""
    parameters = {term: problem.parameters[term] for term in values}
    starts = [_scaled(parameters, values, {})]
    for speed, bend in product(_SPEED_FACTORS, _BEND_FACTORS):
        factors = {STRIBECK_SPEED: speed, PRESLIDING: bend}
        starts.append(_scaled(parameters, values, factors))
    return refine(problem, parameters, starts, MOST_STEPS)


def _fitted_from(
    problem: Problem, values: Mapping[Term, float], held: Collection[Term] = ()
) -> Hypothesis | None:
    """The values fitted, the best of fits from several speeds that all places have alike.

    Those `held` stay at the lower end of their range: bristles there are as good as rigid.
    """
    parameters = {term: problem.parameters[term] for term in values}
    for term in held:
        parameter = parameters[term]
        parameters[term] = replace(parameter, high=parameter.low, default=parameter.low)
    fits = [refine(problem, parameters, [_scaled(parameters, values, {})], MOST_STEPS)]
    if any(term.parameter == STRIBECK_SPEED for term in values):
        for speed in _SPEED_FACTORS:
            starts = []
            for bend in _BEND_FACTORS:
                factors = {STRIBECK_SPEED: speed, PRESLIDING: bend}
                starts.append(_scaled(parameters, values, factors))
            fits.append(refine(problem, parameters, starts, MOST_STEPS))
    found_fits = [fitted for fitted in fits if fitted is not None]
    return min(found_fits, key=lambda fitted: fitted.held_out_rmse, default=None)


def _scaled(
    parameters: Mapping[Term, Parameter],
    values: Mapping[Term, float],
    factors: Mapping[str, float],
) -> list[float]:
    """Values as fits take them; shapes that have a factor are that times their default."""
    scaled = []
    for term, value in values.items():
        parameter = parameters[term]
        factor = factors.get(term.parameter)
        start = value if factor is None else factor * parameter.default
        scaled.append(to_scaled(parameter, start))
    return scaled


def forms(problem: Problem, hypothesis: Hypothesis) -> dict[str, FrictionForm]:
    """By joint, the law that held-out trials ask for, and whether they tell it from the others."""
    joints: dict[str, float] = {}
    for column, (term, value) in zip(hypothesis.columns, hypothesis.values.items(), strict=True):
        parameter = problem.parameters[term]
        if term.effect in FRICTION and parameter.role == "size":
            size = float(np.sqrt((column**2).mean())) * abs(to_scaled(parameter, value))
            joints[term.place] = joints.get(term.place, 0.0) + size
    largest = sorted(joints, key=lambda joint: -joints[joint])[:_MOST_JOINTS]
    return {joint: _form_at(problem, hypothesis, joint) for joint in largest}


def _form_at(problem: Problem, hypothesis: Hypothesis, joint: str) -> FrictionForm:
    """The law with the fewest parts of those that are not clearly worse than the best."""
    rest = {
        term: value
        for term, value in hypothesis.values.items()
        if term.effect not in FRICTION or term.place != joint
    }
    friction_here = {
        term: value
        for term, value in hypothesis.values.items()
        if term.effect in FRICTION and term.place == joint
    }
    viscous = any(term.effect == VISCOUS for term in friction_here)
    laws = _laws(problem, viscous=viscous)
    fits: dict[str, Hypothesis] = {}
    for law in laws:
        start = {**rest, **_start_of(problem, law, joint, friction_here)}
        bristles = [term for term in start if term[1:] == (joint, PRESLIDING)]
        rigid = bristles if "presliding" not in law.parts else []
        fitted = _fitted_from(problem, start, rigid)
        if fitted is not None:
            fits[law.name] = fitted
    best = min(fits.values(), key=lambda fitted: fitted.held_out_rmse)
    apt = [law for law in laws if law.name in fits and not problem.shows(best, fits[law.name])]
    chosen = min(apt, key=lambda law: (len(law.parts), fits[law.name].held_out_rmse))
    rivals = [law.name for law in apt if not chosen.parts <= law.parts]
    return FrictionForm(
        law=chosen.name,
        determined=not rivals,
        rivals=tuple(rivals),
        left_n={name: fitted.held_out_rmse for name, fitted in fits.items()},
    )


def _laws(problem: Problem, *, viscous: bool) -> list[Law]:
    """Laws that this comparison has, each also with viscous friction if that was found."""
    candidates = {c.effect: c for c in problem.simulator.candidates}
    known = {
        effect: {p.name for p in (*candidates[effect].parameters, *candidates[effect].richer)}
        for effect in FRICTION
        if effect in candidates
    }
    offered = [
        law
        for law in LAWS
        if all(known.get(effect, set()) >= set(names) for effect, names in law.numbers.items())
    ]
    if not viscous:
        return offered
    both = [
        Law(
            f"{law.name} and viscous", law.parts | {"viscous"}, {**law.numbers, **_VISCOUS_NUMBERS}
        )
        for law in offered
        if "viscous" not in law.parts
    ]
    return [*offered, *both]


def _start_of(
    problem: Problem, law: Law, joint: str, friction_here: Mapping[Term, float]
) -> dict[Term, float]:
    """Numbers of a law at a joint: as they were found, else typical ones."""
    values = {}
    for effect, names in law.numbers.items():
        always = [
            n for n in _ALWAYS_NUMBERS.get(effect, ()) if (effect, joint, n) in problem.parameters
        ]
        for name in dict.fromkeys((*names, *always)):
            term = Term(effect, joint, name)
            parameter = problem.parameters[term]
            usual = parameter.typical if parameter.role == "size" else parameter.default
            values[term] = friction_here.get(term, usual)
    return values
