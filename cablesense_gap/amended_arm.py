"""The amended arm: its file, and the effects that an arm file lists, judged on a new recording."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from pathlib import Path

import numpy as np
import yaml

from cablesense_base.files import write_atomically
from cablesense_gap.diagnosis.problem import Problem
from cablesense_gap.earlier import judged
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import Earlier
from cablesense_sim.arm import Arm, ArmFileError, ListedEffect, find_arm, parse_arm
from cablesense_sim.effects.effect import WHOLE_ARM
from cablesense_sim.effects.registry import known_effects

AMENDED_ARM = "amended_arm.yaml"
"""In the folder of a diagnosis."""


def amended_arm(arm: Arm, values: Mapping[Term, float], tolerances: Mapping[Term, float]) -> Arm:
    """The arm with further effects after those that it lists; numbers stay in their ranges.

    It keeps its name: without effects it is the nominal arm, so that models and recordings of the
    nominal arm fit it.
    """
    added = [*_listed(arm, values), *_listed(arm, tolerances)]
    return arm.model_copy(update={"effects": [*arm.effects, *added]})


def _listed(arm: Arm, values: Mapping[Term, float]) -> list[ListedEffect]:
    """One entry for each effect and place, in the order of the values."""
    entries = []
    for (name, place), terms in groupby(values, key=lambda term: (term.effect, term.place)):
        effect = known_effects()[name]
        parameters = (*effect.parameters, *effect.history(arm.segment_count, arm.cable_count))
        ranges = {p.name: (p.low, p.high) for p in parameters}
        numbers = {
            term.parameter: float(np.clip(values[term], *ranges[term.parameter])) for term in terms
        }
        entries.append(ListedEffect(effect=name, at=place, parameters=numbers))
    return entries


def find_amended(arm: str) -> Path:
    """The arm file that a name, a path or the folder of a diagnosis means.

    Raises:
        ArmFileError: as `find_arm`, or a folder without an amended arm.
    """
    try:
        return find_arm(arm)
    except ArmFileError:
        folder = Path(arm)
        if not folder.is_dir():
            raise
    if (folder / AMENDED_ARM).is_file():
        return folder / AMENDED_ARM
    raise ArmFileError(
        f"{folder}: has no {AMENDED_ARM}; give the folder of `cablesense gap diagnose`"
    )


def write_arm(path: Path, arm: Arm, heading: str) -> None:
    """Write an arm file that reads back as this very arm, `heading` as comment lines above.

    Raises:
        ArmFileError: the file cannot be written.
    """
    content = arm.model_dump(mode="json", exclude_none=True)
    for effect in content["effects"]:
        if effect["at"] == WHOLE_ARM:
            del effect["at"]
    lines = "".join(f"# {line}\n" for line in heading.splitlines())
    text = lines + yaml.safe_dump(content, sort_keys=False, width=99)
    parse_arm(text, source=str(path))
    write_atomically(path, text, ArmFileError)


def listed_values(arm: Arm) -> dict[Term, float]:
    """The numbers of the effects that an arm file lists, without tolerances."""
    return {
        Term(listed.effect, listed.at, name): value
        for listed in arm.effects
        if not known_effects()[listed.effect].tolerance
        for name, value in listed.parameters.items()
    }


def without_effects(arm: Arm) -> Arm:
    """The arm with its tolerances alone."""
    kept = [e for e in arm.effects if known_effects()[e.effect].tolerance]
    return arm.model_copy(update={"effects": kept})


def judged_earlier(problem: Problem, arm: Arm) -> tuple[Arm, tuple[Earlier, ...]]:
    """The arm with the listed effects that are needed, and a judgement of each listed effect.

    `problem` is that of `without_effects` of the arm. The needed effects get the numbers that
    this recording gives them. An arm whose effects cannot be simulated under the recording stays
    as it is.
    """
    kept, earlier = judged(problem, listed_values(arm))
    if not earlier:
        return arm, ()
    return amended_arm(without_effects(arm), kept, {}), earlier
