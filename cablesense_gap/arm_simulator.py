"""The cable-driven arm as the diagnosis simulates it, and the amended arm that follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_base.files import write_atomically
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.simulator import Assignment, Candidate, Term
from cablesense_sim.arm import Arm, ArmFileError, ListedEffect, find_arm, parse_arm
from cablesense_sim.build import entries_of
from cablesense_sim.effects.effect import WHOLE_ARM, Effect, Transmission
from cablesense_sim.effects.registry import EffectEntry, known_effects, transmissions
from cablesense_sim.equilibrium import EquilibriumError
from cablesense_sim.replay import Replay, reading_variance_n2

AMENDED_ARM = "amended_arm.yaml"
"""In the folder of a diagnosis."""

SLACK_SHARE = 0.05
"""Of the pretension: a cable with less tension is slack or about to be."""


class ArmSimulator:
    """A `Simulator` of an arm under the commands and loads of one recording.

    Attributes: see `Simulator`, and `arm`, the nominal one.
    """

    def __init__(self, arm: Arm, recording: Recording) -> None:
        """What the arm file lists already is part of the nominal arm."""
        self.arm = arm
        self.floor = float(np.sqrt(reading_variance_n2(arm.sensors)))
        sizes = arm.segment_count, arm.cable_count
        effects = known_effects().values()
        self.candidates = tuple(_candidate(e, *sizes) for e in effects if not e.tolerance)
        self.tolerances = tuple(_candidate(e, *sizes) for e in effects if e.tolerance)
        self._listed = entries_of(arm)
        self._replay = Replay(arm, recording.time_s, recording.command_rad, recording.forces_n)
        self._nominal_n: Array | None = None
        self._shape = recording.tensions_n.shape

    def predict(self, variants: Sequence[Assignment]) -> Array:
        """Readings (P, R, M), N.

        Samples that the real arm has borne and a variant cannot are predicted as the nominal arm
        bears them: they speak against the variant, and do not hide the others.
        """
        if self._nominal_n is None and any(variants):
            self._nominal_n = self.predict([{}])[0]
        known = self._nominal_n
        borne = known if known is not None and np.isfinite(known).all() else None
        try:
            entries = [[*self._listed, *entries_from(variant)] for variant in variants]
            return self._replay.readings_n(entries, borne)
        except EquilibriumError:
            if len(variants) == 1:
                return np.full((1, *self._shape), np.nan)
            return np.concatenate([self.predict([variant]) for variant in variants])


def entries_from(variant: Assignment) -> list[EffectEntry]:
    """The effects that an assignment stands for."""
    entries = []
    for (name, place), terms in groupby(
        sorted(variant), key=lambda term: (term.effect, term.place)
    ):
        effect = known_effects()[name]
        values = {p.name: p.default for p in effect.parameters}
        values.update({term.parameter: float(variant[term]) for term in terms})
        entries.append(EffectEntry(effect, place, values))
    return entries


def _candidate(effect: Effect, segment_count: int, cable_count: int) -> Candidate:
    places = effect.places(segment_count, cable_count)
    defaults = {p.name: np.array([p.default]) for p in effect.parameters}
    history_dependent = isinstance(effect.transmission(places[0], defaults), Transmission)
    numbers = (*effect.parameters, *effect.history(segment_count, cable_count))
    return Candidate(effect.name, places, numbers, history_dependent)


def has_one_equilibrium(tensions_n: Array, arm: Arm) -> NDArray[np.bool_]:
    """(…,) whether no segment can have its whole set of cables slack, of tensions (…, M).

    With more of them slack an arm has several static equilibria, and which one it takes is chance.
    """
    slack = tensions_n < SLACK_SHARE * arm.cables.pretension_n
    return np.asarray(slack.sum(-1) < arm.cables.per_segment)


def borne_rows(arm: Arm, recording: Recording) -> NDArray[np.bool_]:
    """(R,) in which an arm finds a rest under what is recorded.

    All of them where it depends on history: which later rests it has is then not known.

    Raises:
        EquilibriumError: an arm finds no rest, and which rows are to blame is not known.
    """
    entries = entries_of(arm)
    replay = Replay(arm, recording.time_s, recording.command_rad, recording.forces_n)
    if transmissions([entries]):
        return np.ones(len(recording), dtype=bool)
    predicted = replay.readings_n([entries], np.full(recording.tensions_n.shape, np.nan))[0]
    return np.asarray(np.isfinite(predicted).all(axis=1))


def counted_rows(arm: Arm, recording: Recording, predicted_n: Array) -> NDArray[np.bool_]:
    """(R,) which rows count in the size of a gap: the arm without its effects has one rest there.

    That is the same for a nominal arm and for what a diagnosis makes of it. Samples that it does
    not bear without its effects are judged by the prediction (R, M) of the arm with them.
    """
    replay = Replay(arm, recording.time_s, recording.command_rad, recording.forces_n)
    return has_one_equilibrium(replay.readings_n([[]], predicted_n)[0], arm)


def amended_arm(arm: Arm, values: Mapping[Term, float], tolerances: Mapping[Term, float]) -> Arm:
    """The arm with effects beside those that it lists already; numbers stay in their ranges.

    It keeps its name: without its effects it is the nominal arm, and whatever was made for that
    one fits it.
    """
    counts = arm.segment_count, arm.cable_count
    listed = [*arm.effects, *_listed(values, *counts), *_listed(tolerances, *counts)]
    return arm.model_copy(update={"effects": listed})


def _listed(
    values: Mapping[Term, float], segment_count: int, cable_count: int
) -> list[ListedEffect]:
    """One entry for each effect and place, in the order in which they were found."""
    found = []
    for (name, place), terms in groupby(values, key=lambda term: (term.effect, term.place)):
        effect = known_effects()[name]
        every = (*effect.parameters, *effect.history(segment_count, cable_count))
        ranges = {p.name: (p.low, p.high) for p in every}
        numbers = {
            term.parameter: float(np.clip(values[term], *ranges[term.parameter])) for term in terms
        }
        found.append(ListedEffect(effect=name, at=place, parameters=numbers))
    return found


def find_amended(arm: str) -> Path:
    """The arm file that a name, a path or the folder of a diagnosis stands for.

    Raises:
        ArmFileError: as `find_arm`, or a folder without an amended arm.
    """
    try:
        return find_arm(arm)
    except ArmFileError:
        folder = Path(arm)
        if not folder.is_dir():
            raise
    amended = folder / AMENDED_ARM
    if amended.is_file():
        return amended
    raise ArmFileError(
        f"{folder}: has no {AMENDED_ARM}; give the folder of `cablesense gap diagnose`"
    )


def write_arm(path: Path, arm: Arm, heading: str) -> None:
    """Write an arm file that reads back as this very arm, `heading` as comment lines above.

    Raises:
        ArmFileError: the place cannot be written to.
    """
    content = arm.model_dump(mode="json", exclude_none=True)
    for effect in content["effects"]:
        if effect["at"] == WHOLE_ARM:
            del effect["at"]
    lines = "".join(f"# {line}\n" for line in heading.splitlines())
    text = lines + yaml.safe_dump(content, sort_keys=False, width=99)
    parse_arm(text, source=str(path))
    write_atomically(path, text, ArmFileError)
