"""A mechanism of no kind in particular, to test the parts of the diagnosis one by one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_gap.diagnosis.fitting import refine
from cablesense_gap.diagnosis.problem import Hypothesis, Problem, prepare
from cablesense_gap.simulator import Assignment, Candidate, Term
from cablesense_sim.effects.effect import Parameter

Change = Callable[[str, dict[str, float]], Array]
"""From a place and the numbers of an effect to what it adds, (R, C)."""

TRIALS = 12
ROWS = 20
CHANNELS = 3
TRIAL = np.repeat(np.arange(TRIALS), ROWS)
TIME = np.tile(np.linspace(0.0, 1.0, ROWS), TRIALS)
FLOOR = 0.1

rng = np.random.default_rng(5)
SIGNALS = rng.normal(size=(8, TRIALS, CHANNELS))[:, TRIAL] * np.cos(
    np.outer(rng.uniform(1.0, 9.0, 8), TIME)
).reshape(8, -1, 1)
"""(8, R, C) unlike each other, and of another strength in each trial."""


def size(name: str, typical: float = 1.0, most: float = 100.0) -> Parameter:
    """A size that may be of either sign."""
    return Parameter(name, "1", -most, most, typical, name)


def rate(starts: tuple[float, ...] = (2.0,)) -> Parameter:
    """A shape that is sought by its logarithm."""
    return Parameter("rate", "1", 0.1, 50.0, 3.0, "rate", 3.0, "shape", starts)


def scatter(std: float = 0.05) -> dict[Candidate, Change]:
    """A tolerance with two places, whose signals no test's effect has."""
    candidate = Candidate("scatter", ("a", "b"), (size("amount", std),))
    by_place = {"a": np.full((len(TRIAL), CHANNELS), 1.0), "b": np.outer(TIME, [1.0, 0.0, -1.0])}
    return {candidate: partial(_added, by_place)}


class Sums:
    """A `Simulator` whose effects add up, each whatever its function of the numbers says."""

    def __init__(
        self,
        candidates: Mapping[Candidate, Change],
        tolerances: Mapping[Candidate, Change] | None = None,
        floor: float = FLOOR,
    ) -> None:
        tolerances = scatter() if tolerances is None else tolerances
        self.candidates = tuple(candidates)
        self.tolerances = tuple(tolerances)
        self.floor = floor
        self.asked: list[Assignment] = []
        self._changes = {c.effect: change for c, change in (candidates | tolerances).items()}
        self._defaults = {
            c.effect: {p.name: p.default for p in c.parameters} for c in candidates | tolerances
        }

    def predict(self, variants: Sequence[Assignment]) -> Array:
        self.asked.extend(variants)
        return np.array([self._one(variant) for variant in variants])

    def _one(self, variant: Assignment) -> Array:
        total = np.zeros((len(TRIAL), CHANNELS))
        for (effect, place), terms in groupby(sorted(variant), key=lambda t: t[:2]):
            numbers = self._defaults[effect] | {t.parameter: variant[t] for t in terms}
            total = total + self._changes[effect](place, numbers)
        return total


def linear(
    effect: str, places: Sequence[str], signals: Array = SIGNALS, most: float = 100.0
) -> dict[Candidate, Change]:
    """An effect that adds one signal (R, C) for each of its places, or all of them at `arm`."""
    by_place = dict(zip([p for p in places if p != "arm"], signals, strict=False))
    by_place["arm"] = sum(by_place.values())
    candidate = Candidate(effect, tuple(places), (size("amount", most=most),))
    return {candidate: partial(_added, by_place)}


def fading(effect: str, places: Sequence[str], **options: bool) -> dict[Candidate, Change]:
    """An effect that fades away at a rate: linear in its size, not in its shape."""
    by_place = dict(zip(places, SIGNALS[6:], strict=False))
    candidate = Candidate(effect, tuple(places), (size("amount"), rate()), **options)
    return {candidate: partial(_fading, by_place)}


def _added(by_place: Mapping[str, Any], place: str, numbers: Mapping[str, float]) -> Array:
    return numbers["amount"] * by_place[place]


def _fading(by_place: Mapping[str, Any], place: str, numbers: Mapping[str, float]) -> Array:
    return np.exp(-numbers["rate"] * TIME)[:, None] * _added(by_place, place, numbers)


def problem_of(
    simulator: Sums, truth: Assignment | Array, seed: int = 0, folds: int = 4
) -> Problem:
    """Readings of the truth, an assignment or an array (R, C), with the simulator's noise."""
    ideal = truth if isinstance(truth, np.ndarray) else simulator.predict([truth])[0]
    noise = np.random.default_rng(seed).normal(0.0, simulator.floor, ideal.shape)
    fold = np.arange(TRIALS) % folds
    used = np.ones(len(TRIAL), dtype=bool)
    return prepare(simulator, ideal + noise, TRIAL, fold, used)


def amount(effect: str, place: str) -> Term:
    """The one number of a linear effect."""
    return Term(effect, place, "amount")


def hypothesis(*effects: str, left: float = 1.0) -> Hypothesis:
    """These effects, each with one size, leaving so much (root mean square) in every trial."""
    fitted = refine(problem_of(Sums({}), {}), {}, [[]])
    assert fitted is not None
    return replace(
        fitted,
        effects=effects,
        values={amount(name, "a"): 1.0 for name in effects},
        deviations={amount(name, "a"): 0.1 for name in effects},
        squares=left**2 * fitted.count,
        sizes=len(effects),
    )


def several(count):
    """As many effects as wanted, each with three places of its own signals."""
    signals_of_effects = np.random.default_rng(3).normal(size=(count, 3, *SIGNALS.shape[1:]))
    library = {}
    for name, signals in zip("defgh", signals_of_effects, strict=False):
        library |= linear(name, "abc", signals)
    return library
