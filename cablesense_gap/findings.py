"""Places and numbers of the effects found, as the verdict names them."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from cablesense_gap.diagnosis.hypothesis import Hypothesis
from cablesense_gap.diagnosis.scaled import to_scaled
from cablesense_gap.simulator import Candidate, Term
from cablesense_gap.verdict import Estimate, Where

NEGLIGIBLE = 0.1
"""A place that changes the readings by less than this share of the foremost one is not named."""


def foremost(hypothesis: Hypothesis, candidates: tuple[Candidate, ...]) -> dict[Term, float]:
    """The values in those places that matter, effect by effect."""
    parameters = {(c.effect, p.name): p for c in candidates for p in c.parameters}
    changes: dict[tuple[str, str], float] = {}
    for column, (term, value) in zip(hypothesis.columns, hypothesis.values.items(), strict=True):
        parameter = parameters[term.effect, term.parameter]
        if parameter.role == "size":
            size = float(np.sqrt((column**2).mean())) * abs(to_scaled(parameter, value))
            key = term.effect, term.place
            changes[key] = float(np.hypot(changes.get(key, 0.0), size))
    largest = {
        effect: max(size for (name, _), size in changes.items() if name == effect)
        for effect in hypothesis.effects
    }
    return {
        term: value
        for term, value in hypothesis.values.items()
        if changes[term.effect, term.place] >= NEGLIGIBLE * largest[term.effect]
    }


def where(values: Mapping[Term, float], regimes: tuple[str, ...]) -> Where:
    """The places by kind; an effect of the whole arm names none."""
    named: dict[str, set[int]] = {"cable": set(), "segment": set(), "joint": set()}
    for term in values:
        place = term.place.split("_into_")[0]  # of a leak, the channel that it comes from
        for kind, number in re.findall(r"(cable|segment|joint)_(\d+)", place):
            named[kind].add(int(number))
    listed = {
        kind: tuple(f"{kind}_{n}" for n in sorted(numbers)) for kind, numbers in named.items()
    }
    return Where(
        cables=listed["cable"],
        segments=listed["segment"],
        joints=listed["joint"],
        regimes=regimes,
    )


def estimates(
    values: Mapping[Term, float],
    deviations: Mapping[Term, float],
    candidates: tuple[Candidate, ...],
) -> dict[str, Estimate]:
    """Numbers with units, and intervals within what is plausible.

    The place is in the name where there are several, of one effect or of two.
    """
    known = {(c.effect, p.name): p for c in candidates for p in c.parameters}
    single = len({(term.effect, term.place) for term in values}) == 1
    found = {}
    for term, value in values.items():
        parameter, half = known[term.effect, term.parameter], deviations[term]
        found[f"{term.effect}.{term.parameter}" if single else str(term)] = Estimate(
            value=value,
            unit=parameter.unit,
            ci95=(max(value - half, parameter.low), min(value + half, parameter.high)),
        )
    return found
