"""The load histories of a history-dependent arm's samples, and the tensions along them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim.effects.registry import (
    EffectEntry,
    actuations,
    amended,
    sensings,
    transmissions,
)
from cablesense_sim.equilibrium import EquilibriumError, held_lengths_m, solve_equilibrium
from cablesense_sim.mechanism import Mechanism

_ON_THE_WAY = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
"""Shares of the way to the command, at which the arm comes to rest."""

_RISE = np.array([0.2, 0.4, 0.6, 0.8, 1.0])
"""Shares of the highest force on the way up."""

_BACK = np.array([0.5, 1.0, 1.0])
"""Shares of the way from there to the sample's force; the last is where it is read."""

_RESTS = len(_ON_THE_WAY) + len(_RISE) + len(_BACK)

TARED = len(_ON_THE_WAY) - 1
"""The rest at which the tare is taken; the reading is that of the last."""

_STEP_S = 0.5
_LONGEST_WAIT_S = 30.0
_LONGEST_HOLD_S = 5.0
_HIGHEST_PEAK = 1.4


@dataclass(frozen=True)
class LoadHistory:
    """What B samples go through in R rests: from another pose to the command, then the load.

    Attributes:
        time_s: (R,) of the rests.
        from_share: (B,) of the command, -1 to 1: the pose at the start.
        peak_share: (B,) of the sample's force, from 1 up: the highest force on the way.
    """

    time_s: Array
    from_share: Array
    peak_share: Array

    @classmethod
    def drawn(cls, count: int, rng: np.random.Generator) -> LoadHistory:
        """A history for `count` samples; half of them are loaded beyond their force and back."""
        steps = np.full(_RESTS, _STEP_S)
        steps[TARED] += rng.uniform(0.0, _LONGEST_WAIT_S)
        steps[TARED + 1] += rng.uniform(0.0, _LONGEST_WAIT_S)
        steps[-1] = rng.uniform(0.0, _LONGEST_HOLD_S)
        beyond = rng.random(count) < 0.5
        peak = np.where(beyond, rng.uniform(1.0, _HIGHEST_PEAK, count), 1.0)
        return cls(np.cumsum(steps), rng.uniform(-1.0, 1.0, count), peak)

    @classmethod
    def plain(cls, count: int) -> LoadHistory:
        """At the command and the force at once, for arms that do not depend on history."""
        return cls(np.arange(_RESTS, dtype=float), np.ones(count), np.ones(count))

    def select(self, rows: NDArray[np.int64]) -> LoadHistory:
        """The same for some of the samples."""
        return LoadHistory(self.time_s, self.from_share[rows], self.peak_share[rows])

    def commands_rad(self, command_rad: Array) -> Array:
        """(R, B, 2N) for the samples' commands (B, 2N)."""
        way = np.append(_ON_THE_WAY, np.ones(_RESTS - len(_ON_THE_WAY)))
        share = self.from_share + way[:, None] * (1.0 - self.from_share)
        return share[..., None] * command_rad

    def loads_n(self, forces_n: Array) -> Array:
        """(R, B, N, 3) for the samples' loads (B, N, 3)."""
        none = np.zeros((len(_ON_THE_WAY), len(forces_n)))
        rise = _RISE[:, None] * self.peak_share
        back = self.peak_share + _BACK[:, None] * (1.0 - self.peak_share)
        return np.concatenate([none, rise, back])[..., None, None] * forces_n


def solved_rows(
    shape: tuple[int, ...], allowed_failures: int, solve: Callable[[NDArray[np.int64]], Array]
) -> Array:
    """What `solve` gives for rows, the last axis but one of `shape`; NaN without equilibrium.

    Raises:
        EquilibriumError: more rows than allowed have none; it names one of the last.
    """
    whole = np.full(shape, np.nan)
    rows = np.arange(shape[-2])
    while rows.size:
        try:
            whole[..., rows, :] = solve(rows)
        except EquilibriumError as error:
            allowed_failures -= error.failed.size
            if not error.failed.size or allowed_failures < 0:
                raise
            rows = np.delete(rows, error.failed)
        else:
            break
    return whole


def tensions_along_n(
    nominal: Mechanism,
    entries: list[EffectEntry],
    time_s: Array,
    commands_rad: Array,
    loads_n: Array,
    needed: Sequence[int],
    places_m: Array | None = None,
) -> Array:
    """True tensions (R, B, M) of an arm with effects, from rest to rest at times (R,).

    Commands are (R, B, 2N), loads (R, B, N, 3). They act at `places_m` (B, N) from the segments'
    joint centres, by default at the arm's contact points. If nothing depends on the history,
    tensions are zero at rests that are not `needed`. An `EquilibriumError` says which arms find
    no rest.
    """
    held, arms = held_lengths_m(nominal, commands_rad), [entries] * commands_rad.shape[1]
    for actuation in actuations(arms):
        held = actuation.along(time_s, held.swapaxes(0, 1)).swapaxes(0, 1)
    mechanism = amended(nominal, entries)
    if transmissions(arms):
        from cablesense_sim.quasi_static import QuasiStaticArm  # compiled: others need not wait

        arm = QuasiStaticArm([mechanism] * len(arms), arms)
        rests = zip(time_s, held, loads_n, strict=True)
        return np.stack([arm.step(*rest, places_m) for rest in rests])
    if places_m is not None:
        mechanism = replace(mechanism, contact_m=places_m)
    tensions = np.zeros_like(held)
    for row in range(len(held)) if sensings(arms) else needed:
        rest = solve_equilibrium(mechanism, commands_rad[row], loads_n[row], held_m=held[row])
        tensions[row] = rest.tensions_n
    return tensions


def sensed_along_n(entries: list[EffectEntry], time_s: Array, tensions_n: Array) -> Array:
    """Readings of tensions (B, R, M) at times (R,), with the sensors' effects."""
    for sensing in sensings([entries] * len(tensions_n)):
        tensions_n = sensing.along(time_s, tensions_n)
    return tensions_n
