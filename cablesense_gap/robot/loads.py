"""Loads that a robot bears beyond its model: found in a healthy recording, taken off, stated.

The load of the healthy robot becomes a part of the nominal one. A payload there may then be
negative, down to what was borne: what a verdict names is the change.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from cablesense_gap.diagnosis.fitting import refine
from cablesense_gap.diagnosis.problem import Hypothesis, Problem, unit_of
from cablesense_gap.explained import Changes, removes
from cablesense_gap.robot.effects.mechanics import AddedMass
from cablesense_gap.simulator import Assignment, Candidate, Term
from cablesense_gap.verdict import FittedNumber

PAYLOAD = AddedMass.name
_LEFT_SHARE = 0.5**0.5
"""Share of what is left without it that a load of the healthy robot leaves at most: it explains
most of the mean square. Imperfect models without a load are explained less."""
_TAKEN_OFF = 1.1
"""Share of a listed load that can be taken off: the load is known to some per cent."""


def with_sign(candidate: Candidate, listed: Assignment) -> list[Candidate]:
    """A payload apart for each body where the robot lists one: it may be negative there."""
    if candidate.effect != PAYLOAD:
        return [candidate]
    mass, *moments = candidate.parameters
    listed_kg = {
        body: value
        for body in candidate.places
        if (value := listed.get(Term(PAYLOAD, body, mass.name), 0.0)) > 0.0
    }
    without = tuple(body for body in candidate.places if body not in listed_kg)
    parts = [replace(candidate, places=without)]
    for body, most_kg in listed_kg.items():
        signed = replace(mass, low=-_TAKEN_OFF * most_kg)
        parts.append(replace(candidate, places=(body,), parameters=(signed, *moments)))
    return [part for part in parts if part.places]


def borne(
    problem: Problem, candidates: Sequence[Candidate], without_effects: Hypothesis
) -> Hypothesis | None:
    """The payload that explains most of a healthy recording; None if that is not clear.

    It leaves clearly less than without it on held-out trials.
    """
    loads = []
    for candidate in candidates:
        if candidate.effect != PAYLOAD:
            continue
        start = [1.0, *(0.0 for _ in candidate.parameters[1:])]
        for body in candidate.places:
            numbers = dict(zip(candidate.terms(body), candidate.parameters, strict=True))
            loads.append(refine(problem, numbers, [start]))
    fitted = [load for load in loads if load is not None]
    if not fitted:
        return None
    best = min(fitted, key=problem.score)
    less = best.held_out_rmse < _LEFT_SHARE * without_effects.held_out_rmse
    clear = best.is_clearly_better_than(without_effects)
    return best if less and clear and removes(Changes(problem, best)) else None


def with_places(
    fitted: Mapping[str, FittedNumber], hypothesis: Hypothesis, candidates: Sequence[Candidate]
) -> dict[str, FittedNumber]:
    """The numbers of a verdict, with the places of its payloads, m from the centre of mass.

    A place is p = μ / m of the first moment μ and the mass m, and is linear about the fit:
    δp = (δμ - p δm) / m.
    """
    numbers = dict(fitted)
    terms = list(hypothesis.values)
    for candidate in candidates:
        if candidate.effect != PAYLOAD:
            continue
        mass, *moments = candidate.parameters
        for body in candidate.places:
            mass_term = Term(PAYLOAD, body, mass.name)
            prefix = PAYLOAD if f"{PAYLOAD}.{mass.name}" in numbers else f"{PAYLOAD}.{body}"
            mass_kg = hypothesis.values.get(mass_term, 0.0)
            if f"{prefix}.{mass.name}" not in numbers or mass_kg == 0.0:
                continue
            for axis, moment in zip("xyz", moments, strict=True):
                moment_term = Term(PAYLOAD, body, moment.name)
                place_m = hypothesis.values[moment_term] / mass_kg
                slope = np.zeros(len(terms))
                slope[terms.index(moment_term)] = unit_of(moment, 0.0) / mass_kg
                slope[terms.index(mass_term)] = -place_m * unit_of(mass, 0.0) / mass_kg
                variance_m2 = float(slope @ hypothesis.covariance @ slope)
                half_m = 1.96 * max(variance_m2, 0.0) ** 0.5
                numbers[f"{prefix}.place_{axis}_m"] = FittedNumber(
                    value=place_m, unit="m", ci95=(place_m - half_m, place_m + half_m)
                )
    return numbers
