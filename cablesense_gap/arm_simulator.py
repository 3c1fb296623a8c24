"""The cable-driven arm as the diagnosis simulates it, and its state at the first rows."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.arm_nuisance import tolerance_candidates
from cablesense_gap.simulator import Assignment, Candidate, parameters_of, predicted_changes
from cablesense_recording.recording import Recording
from cablesense_sim.arm import Arm, ListedEffect
from cablesense_sim.build import entries_of
from cablesense_sim.effects.effect import Effect, Parameter, Transmission
from cablesense_sim.effects.registry import EffectEntry, known_effects, transmissions
from cablesense_sim.equilibrium import EquilibriumError
from cablesense_sim.replay import Replay, reading_variance_n2

_SAME_N = 1e-3
"""Tensions that differ by less are of one equilibrium, which is balanced to some 1e-5 N."""
_FOLLOWED_ROWS = 16
"""Rows over which an equilibrium is followed: one that a load turned to may last so long."""
_SIMILAR_ARMS = 16
"""Arms with other tolerances, by whose scatter rows are judged: enough for a scatter to a
fifth."""
_MOST_SCATTER = 5.0
"""By how many times their readings may scatter more in a row that counts than in the middle one:
on arms drawn at random 3 to 4 times where nothing turns."""
_DEFAULT_WEIGHT = 0.05
"""Weight of the default state against residuals in units of the floor: first rows that do not
show a state leave it at its default."""
_MOST_EVALUATIONS = 12
"""Of the residuals, in the fit of states: these act nearly linearly on the first rows."""


class ArmSimulator:
    """A `Simulator` of an arm under the commands and loads of one recording.

    Attributes:
        arm: the nominal one.
        candidates: effects to choose among.
        tolerances: of the arm; each parameter's `typical` is its standard deviation.
        floor: RMS of what the sensors add to a perfect reading, N.
    """

    def __init__(self, arm: Arm, recording: Recording) -> None:
        """Take an arm, with the effects that its file lists as its nominal state, and R rows."""
        self.arm = arm
        self.floor = float(np.sqrt(reading_variance_n2(arm.sensors)))
        sizes = arm.segment_count, arm.cable_count
        effects = known_effects().values()
        self.candidates = tuple(_candidate(e, *sizes) for e in effects if not e.tolerance)
        self.tolerances = tolerance_candidates(arm)
        self._listed = entries_of(arm)
        self._replay = Replay(arm, recording.course)
        self._nominal_n: Array | None = None
        self._shape = recording.tensions_n.shape

    def predict(self, variants: Sequence[Assignment]) -> Array:
        """Readings (P, R, M), N.

        Samples in which a variant has no equilibrium, although the real arm had one, are predicted
        by the nominal arm: they count against the variant, and do not hide the others.
        """
        if self._nominal_n is None and any(variants):
            self._nominal_n = self.predict([{}])[0]
        known = self._nominal_n
        fallback = known if known is not None and np.isfinite(known).all() else None
        try:
            entries = [[*self._listed, *entries_from(variant)] for variant in variants]
            return self._replay.readings_n(entries, fallback)
        except EquilibriumError:
            if len(variants) == 1:
                return np.full((1, *self._shape), np.nan)
            return np.concatenate([self.predict([variant]) for variant in variants])

    def small_changes(self, base: Assignment, variants: Sequence[Assignment]) -> Array:
        """Changes (P, R, M) of the readings by small differences from a base."""
        zeros = dict.fromkeys((*base, *(term for variant in variants for term in variant)), 0.0)
        whole = [{**zeros, **variant} for variant in (base, *variants)]
        entries = [[*self._listed, *entries_from(variant)] for variant in whole]
        if not transmissions(entries[:1]):
            with suppress(EquilibriumError):
                return self._replay.small_changes_n(entries[0], entries[1:])
        return predicted_changes(self, whole[0], whole[1:])


def entries_from(variant: Assignment) -> list[EffectEntry]:
    """The effects with the values of an assignment, for a `Replay`."""
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
    return Candidate(effect.name, places, numbers, history_dependent, effect.against_motion)


def supported_rows(arm: Arm, recording: Recording) -> NDArray[np.bool_]:
    """(R,) in which an arm has an equilibrium under the recorded commands and loads.

    All of them if it depends on history, as later equilibria then follow from earlier ones.

    Raises:
        EquilibriumError: a history-dependent arm has no equilibrium in some row.
    """
    entries = entries_of(arm)
    replay = Replay(arm, recording.course)
    if transmissions([entries]):
        return np.ones(len(recording), dtype=bool)
    predicted = replay.readings_n([entries], np.full(recording.tensions_n.shape, np.nan))[0]
    return np.asarray(np.isfinite(predicted).all(axis=1))


def counted_rows(arm: Arm, recording: Recording, predicted_n: Array) -> NDArray[np.bool_]:
    """(R,) which rows count in the size of a gap, by the arm without effects.

    The nominal and the amended arm then count the same rows. Rows without an equilibrium of the
    arm without effects are judged by the prediction (R, M) of the arm with its effects.

    A row does not count if its equilibrium is not the only one. A segment that a load has turned
    to one side may also rest on the other, so the search begins on each side. An arm may keep a
    rest while the load changes, so the search also begins at the rests of the rows before and
    after. The rows next to such a row do not count either: an unknown effect may make the arm turn
    there. A row whose load nearly turns a segment does not count: there manufacturing tolerances
    change the readings far more than elsewhere, and not in proportion.
    """
    replay = Replay(arm, recording.course)
    (direct_n,) = replay.readings_n([[]], predicted_n)
    equilibrium_rad = replay.equilibrium_rad
    others: list[Array] = []
    for axis in range(2):
        mirrored_rad = equilibrium_rad.copy()
        mirrored_rad[:, axis::2] = (2.0 * recording.command_rad - equilibrium_rad)[:, axis::2]
        others.append(replay.searching_from(mirrored_rad).readings_n([[]], predicted_n)[0])
    for step in (1, -1):
        follower = replay.searching_from(equilibrium_rad)
        followed_n = direct_n
        for _ in range(_FOLLOWED_ROWS):
            before_n = followed_n
            begin_rad = np.roll(follower.equilibrium_rad, step, axis=0)
            follower = follower.searching_from(begin_rad)
            followed_n = follower.readings_n([[]], predicted_n)[0]
            if np.abs(followed_n - before_n).max() < _SAME_N:
                break
        others.append(followed_n)
    off = np.abs(np.array(others) - direct_n).max(axis=(0, 2)) >= _SAME_N
    off = np.isin(replay.group_of_row, replay.group_of_row[off])
    same = ~(off | np.append(off[1:], False) | np.append(False, off[:-1]))
    similar = replay.readings_n(_similar_arms(arm), predicted_n)
    scatter_n = np.sqrt((np.subtract(similar, direct_n) ** 2).mean(0)).max(-1)
    usual_n = np.median(scatter_n[same]) if same.any() else 0.0
    return np.asarray(same & (scatter_n <= _MOST_SCATTER * usual_n))


def _similar_arms(arm: Arm) -> list[list[EffectEntry]]:
    """Arms with other tolerances, each one standard deviation from its nominal value."""
    tolerances = parameters_of(tolerance_candidates(arm))
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (_SIMILAR_ARMS, len(tolerances)))
    std = np.array([p.typical for p in tolerances.values()])
    return [entries_from(dict(zip(tolerances, each * std, strict=True))) for each in signs]


def settled(arm: Arm, recording: Recording, rows: int) -> Arm:
    """The arm with the history-dependent states that the first `rows` of a recording show.

    The position in a play, friction states and creep belong to a recording, and not to the arm.

    Raises:
        EquilibriumError: the arm has no equilibrium in these rows.
    """
    from scipy.optimize import least_squares

    states = _states(arm)
    if not states or rows < 1:
        return arm
    first = recording.rows(slice(0, rows))
    low, high = np.array([[p.low, p.high] for _, p in states]).T / (
        typical := np.array([p.typical for _, p in states])
    )
    start = np.clip([p.default / p.typical for _, p in states], low + 1e-6, high - 1e-6)

    def residuals(scaled: Array) -> Array:
        simulator = ArmSimulator(_with_states(arm, states, scaled * typical), first)
        residual = (first.tensions_n - simulator.predict([{}])[0]) / simulator.floor
        return np.concatenate(
            [np.nan_to_num(residual, nan=1e3).ravel(), _DEFAULT_WEIGHT * (scaled - start)]
        )

    optimum = least_squares(
        residuals,
        start,
        bounds=(low, high),
        x_scale=1.0,
        diff_step=0.02,
        max_nfev=_MOST_EVALUATIONS,
    )
    return _with_states(arm, states, optimum.x * typical)


def _states(arm: Arm) -> list[tuple[int, Parameter]]:
    """Parameters of history-dependent states, with the index of their effect in the arm's list."""
    states = []
    for k, listed in enumerate(arm.effects):
        effect = known_effects()[listed.effect]
        history = effect.history(arm.segment_count, arm.cable_count)
        states += [(k, p) for p in (*effect.parameters, *history) if p.past]
    return states


def _with_states(arm: Arm, states: Sequence[tuple[int, Parameter]], values: Array) -> Arm:
    effects: list[ListedEffect] = list(arm.effects)
    for (k, parameter), value in zip(states, values, strict=True):
        numbers = {**effects[k].parameters, parameter.name: float(value)}
        effects[k] = effects[k].model_copy(update={"parameters": numbers})
    return arm.model_copy(update={"effects": effects})
