"""The cable-driven arm as the diagnosis sees it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.recordings.recording import Recording
from cablesense_gap.simulator import Assignment, Candidate, Term
from cablesense_sim.arm import Arm
from cablesense_sim.effects.effect import Effect
from cablesense_sim.effects.entry import EffectEntry, entries_of
from cablesense_sim.effects.registry import known_effects
from cablesense_sim.effects.transmission import Transmission
from cablesense_sim.equilibrium import EquilibriumError
from cablesense_sim.replay import Replay
from cablesense_sim.sensors import reading_variance_n2

Array = NDArray[np.float64]


class ArmSimulator:
    """A `Simulator` of an arm under the commands and loads of one recording.

    Attributes: see `Simulator`.
    """

    def __init__(self, arm: Arm, recording: Recording) -> None:
        """What the arm file lists already is part of the nominal arm."""
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
            return self._replay.readings_n([self._entries(v) for v in variants], borne)
        except EquilibriumError:
            if len(variants) == 1:
                return np.full((1, *self._shape), np.nan)
            return np.concatenate([self.predict([variant]) for variant in variants])

    def _entries(self, variant: Assignment) -> list[EffectEntry]:
        return [*self._listed, *entries_from(variant)]


def entries_from(variant: Assignment) -> list[EffectEntry]:
    """The effects that an assignment stands for, in the order of the chain of their actions."""
    entries = []
    ordered = sorted(variant, key=lambda term: (_order(term), term))
    for (name, place), terms in groupby(ordered, key=lambda term: (term.effect, term.place)):
        effect = known_effects()[name]
        values = {p.name: p.default for p in effect.parameters}
        values.update({term.parameter: float(variant[term]) for term in terms})
        entries.append(EffectEntry(effect, place, values))
    return entries


_CHAIN: Mapping[str, int] = {"sensor_crosstalk": 1, "sensor_lag": 2, "sensor_gain": 3}
"""Sensors: what leaks is tension, what is late is the signal, and offsets come last."""


def _order(term: Term) -> int:
    effect = known_effects()[term.effect]
    return 0 if effect.acts_on != "sensor" and not effect.tolerance else _CHAIN.get(term.effect, 4)


def _candidate(effect: Effect, segment_count: int, cable_count: int) -> Candidate:
    places = effect.places(segment_count, cable_count)
    defaults = {p.name: np.array([p.default]) for p in effect.parameters}
    remembers = isinstance(effect.transmission(places[0], defaults), Transmission)
    numbers = (*effect.parameters, *effect.history(segment_count, cable_count))
    return Candidate(effect.name, places, numbers, remembers)
