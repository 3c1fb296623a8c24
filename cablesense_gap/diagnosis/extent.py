"""The extent of an unlisted remainder, and the problem without the readings in which it acts.

Something that no list has acts in some channels, or in some trials, beside effects of the list. In
the other readings the listed effects explain all that there is, so they are fitted to these.
Channels or trials are given to the remainder one after the other: always those in which the best
listed explanation of the others leaves most. Channels come one by one, and with those that share a
cause, as the cables that end on a segment.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from math import comb

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.diagnosis.fitting import refine, refit
from cablesense_gap.diagnosis.problem import Hypothesis, Problem, Subsample
from cablesense_gap.diagnosis.selection import LinearEffect, Proposal, Selection, linear_effects
from cablesense_gap.simulator import Assignment, Simulator, small_changes

_MOST_READINGS = 20_000
"""That are looked at to choose an extent: readings of neighbouring rows say the same."""
_GROWTH = 1.5
"""Factor of the number of channels from one extent to the next, where that is more than one."""


@dataclass(frozen=True)
class Extent:
    """The readings in which a remainder acts.

    Attributes:
        channels: (C,) in which it acts all the time.
        trials: (T,) in which it acts in all channels.
        choices: how many extents are possible, if each number of channels, of groups of them and
            of trials is as probable as another, and all extents of this number are.
    """

    channels: NDArray[np.bool_]
    trials: NDArray[np.bool_]
    choices: int

    @staticmethod
    def whole(problem: Problem) -> Extent:
        """All readings."""
        channels = np.ones(problem.readings.shape[1], dtype=bool)
        return Extent(channels, np.zeros(len(problem.fold), dtype=bool), 1)

    @property
    def is_whole(self) -> bool:
        """Whether these are all readings."""
        return bool(self.channels.all())

    @property
    def share(self) -> float:
        """Share of all readings, where trials are alike."""
        return 1.0 - float((1.0 - self.channels.mean()) * (1.0 - self.trials.mean()))

    def readings(self, problem: Problem) -> NDArray[np.bool_]:
        """(R, C) which readings of the used rows these are."""
        in_trials = self.trials[problem.trial]
        return (self.channels | in_trials[:, None]) & problem.used[:, None]

    @property
    def log_choices(self) -> float:
        """What its choice costs, natural logarithm."""
        return float(np.log(self.choices))


@dataclass(frozen=True)
class Screened:
    """An extent, and what the listed effects leave of the other readings, linear about no effect.

    Attributes:
        without_effects: fitted to the other readings that were looked at.
        proposals: effects that explain them, the most promising first.
    """

    extent: Extent
    without_effects: Hypothesis
    proposals: Sequence[Proposal]


class _OfChannels:
    """A simulator of some channels of another."""

    def __init__(self, simulator: Simulator, kept: NDArray[np.bool_]) -> None:
        self._simulator = simulator
        self._kept = kept
        self.floor = simulator.floor
        self.candidates = simulator.candidates
        self.tolerances = simulator.tolerances

    def predict(self, variants: Sequence[Assignment]) -> Array:
        """The kept ones of the channels (P, R, C) of P variants."""
        return self._simulator.predict(variants)[:, :, self._kept]

    def small_changes(self, base: Assignment, variants: Sequence[Assignment]) -> Array:
        """The kept ones of the changes (P, R, C) by small differences from a base."""
        return small_changes(self._simulator, base, variants)[:, :, self._kept]


def without_extent(problem: Problem, extent: Extent) -> Problem:
    """The problem without the readings of an extent."""
    kept = ~extent.channels
    subsample = problem.subsample
    if subsample is not None:
        subsample = Subsample(subsample.rows, without_extent(subsample.problem, extent))
    return replace(
        problem,
        simulator=_OfChannels(problem.simulator, kept),
        readings=problem.readings[:, kept],
        used=problem.used & ~extent.trials[problem.trial],
        nominal=problem.nominal[:, kept],
        nuisance_columns=problem.nuisance_columns[:, :, kept],
        nuisance_remainder=problem.nuisance_remainder[:, kept],
        nuisance_change=problem.nuisance_change[:, kept],
        subsample=subsample,
    )


def over_all_readings(problem: Problem, extent: Extent, fitted: Hypothesis) -> Hypothesis:
    """A hypothesis that was fitted without the readings of an extent, for all readings.

    Effects and nuisance parameters keep their numbers. They have not seen the extent, so its
    readings are predicted as held-out ones are.
    """
    simulated = refit(problem, fitted.values, 0)
    assert simulated is not None  # the extent is no other machine
    predicted = simulated.without_nuisance
    coefficients = problem.coefficients_of(fitted.nuisance)
    of_nuisance = np.tensordot(coefficients, problem.nuisance_columns, axes=1)
    prediction = predicted + of_nuisance + problem.nuisance_remainder
    held_out = prediction.copy()
    held_out_effects = predicted.copy()
    seen_rows = ~extent.trials[problem.trial]
    seen = np.ix_(seen_rows, ~extent.channels)
    held_out[seen] = fitted.held_out[seen_rows]
    held_out_effects[seen] = fitted.held_out_effects[seen_rows]
    squares, count = problem.squares_by_trial(held_out)
    return replace(
        fitted,
        prediction=prediction,
        without_nuisance=predicted,
        columns=simulated.columns,
        held_out=held_out,
        held_out_effects=held_out_effects,
        squares=squares,
        count=count,
    )


def screened_extents(problem: Problem, groupings: Sequence[NDArray[np.int64]]) -> list[Screened]:
    """Extents of growing size with what listed effects leave beside them.

    Each of the groupings (C,) says which channels belong together. Effects that depend on history
    are left out: they are expensive to simulate. Of many rows some are looked at, at equal
    distances.
    """
    problem = _with_fewer_rows(problem)
    without_effects = refine(problem, {}, [[]])
    assert without_effects is not None
    candidates = [c for c in problem.simulator.candidates if not c.history_dependent]
    columns = list(
        chain.from_iterable(linear_effects(problem, c, without_effects) for c in candidates)
    )
    screened = list(_by_trials(problem, columns))
    for groups in groupings:
        screened.extend(_by_channels(problem, columns, groups))
    kinds = len(screened)
    return [
        replace(each, extent=replace(each.extent, choices=kinds * each.extent.choices))
        for each in screened
    ]


def _with_fewer_rows(problem: Problem) -> Problem:
    """The problem with at most some of its used rows, at equal distances."""
    rows = np.flatnonzero(problem.used)
    stride = -(-len(rows) * problem.readings.shape[1] // _MOST_READINGS)
    used = np.zeros_like(problem.used)
    used[rows[::stride]] = True
    return replace(problem, used=used)


def _by_channels(
    problem: Problem, columns: Sequence[LinearEffect], groups: NDArray[np.int64]
) -> Iterator[Screened]:
    """One, two, three, four, six … groups of channels are the remainder's, at last all but one."""
    count = len(np.unique(groups))
    channels = np.zeros(len(groups), dtype=bool)
    no_trial = np.zeros(len(problem.fold), dtype=bool)
    size = 0
    while size < count:
        extent = Extent(channels.copy(), no_trial, comb(count, size))
        screened, left = _screened(problem, columns, extent)
        if size:
            yield screened
        square = np.bincount(groups[~channels], (left**2).mean(0), count)
        larger = max(size + 1, min(int(_GROWTH * size), count - 1))
        channels |= np.isin(groups, np.argsort(square)[::-1][: larger - size])
        size = larger


def _by_trials(problem: Problem, columns: Sequence[LinearEffect]) -> Iterator[Screened]:
    """One, two, four … trials are the remainder's, fewer than half of them."""
    count = len(problem.fold)
    no_channel = np.zeros(problem.readings.shape[1], dtype=bool)
    trials = np.zeros(count, dtype=bool)
    size = 0
    while 2 * size < count:
        extent = Extent(no_channel, trials.copy(), comb(count, size))
        screened, left = _screened(problem, columns, extent)
        if size:
            yield screened
        rows = problem.used & ~trials[problem.trial]
        square = np.bincount(problem.trial[rows], (left**2).mean(1), count)
        size = max(1, 2 * size)
        trials[np.argsort(square)[::-1][: size - int(trials.sum())]] = True


def _screened(
    problem: Problem, columns: Sequence[LinearEffect], extent: Extent
) -> tuple[Screened, Array]:
    """The best listed effects beside a remainder, and what they leave of the used rows."""
    others = without_extent(problem, extent)
    without_effects = refine(others, {}, [[]])
    assert without_effects is not None
    kept = ~extent.channels
    offered = [replace(each, columns=each.columns[:, :, kept]) for each in columns]
    selection = Selection(others, without_effects, offered)
    proposals = selection.additions() if offered else []
    left = others.readings - without_effects.prediction
    if proposals:
        left = selection.left_by(proposals[0])
    return Screened(extent, without_effects, proposals), left[others.used]
