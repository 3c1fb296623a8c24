"""What 54 numbers can carry: the diagnosis of Table II on simulated tables with known causes.

No calibration made on long recordings of another arm holds here, so the probability of a verdict
comes from this: tables of each kind are drawn, diagnosed like the measured one, and counted.

They are compared by what listed effects leave of the table that they were fitted to, not of rows
held out. That is the kinder measure to the listed, and on simulated tables the sharper: a cable
that goes slack shows in one row or two, which no other row tells of.
"""

from __future__ import annotations

import json
import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cablesense_gap.diagnosis.course import prepare
from cablesense_gap.diagnosis.hypothesis import Hypothesis
from cablesense_gap.diagnosis.searching import search
from cablesense_gap.one_number import Explained, Scan, explain
from cablesense_gap.simulator import Array, Assignment
from cablesense_gap.tension_changes import ChangeSimulator

KINDS = ("one listed effect", "two listed effects", "something unlisted")
SMALLEST_N, LARGEST_N = 0.5, 3.0
"""Gaps that are rehearsed; the measured one lies between."""

SHIPPED = Path(__file__).with_name("rehearsal.json")
"""Counts of a long rehearsal (`benchmarks/table2_gap.py`), which takes minutes."""

PRIOR_UNLISTED = 0.2
"""Share of causes outside the library that one expects before looking."""


@dataclass(frozen=True)
class Judged:
    """A table under every explanation.

    Attributes:
        singles: each number over its range.
        hypotheses: of the search, up to two effects at once.
        least_left: least that any of them leaves of the whole table that it was fitted to, as a
            share of the gap.
    """

    singles: tuple[Explained, ...]
    hypotheses: tuple[Hypothesis, ...]
    least_left: float


@dataclass(frozen=True)
class Rehearsal:
    """Counts over simulated tables.

    Attributes:
        count: tables of each kind.
        unexplained: of each kind, those of which listed effects leave as large a share of the gap
            as of the measured one, or larger.
        named: with one listed effect, those where the number that leaves least on held-out rows
            belongs to the true effect.
        mistaken: how often (true, named) differ.
    """

    count: int
    unexplained: dict[str, int]
    named: int
    mistaken: dict[tuple[str, str], int]

    @property
    def probability(self) -> float:
        """That a table is unlisted, given that it is left unexplained."""
        one, two, unlisted = (self.unexplained[kind] for kind in KINDS)
        by_listed = _rate(one + two, 2 * self.count)
        odds = PRIOR_UNLISTED * _rate(unlisted, self.count) / ((1.0 - PRIOR_UNLISTED) * by_listed)
        return odds / (1.0 + odds)


def judge(simulator: ChangeSimulator, scans: Sequence[Scan], changes_n: Array) -> Judged:
    """Fit everything to a table (K, M); rows are held out one by one."""
    rows = np.arange(len(changes_n))
    singles = tuple(explain(found, changes_n, rows) for found in scans)
    course = prepare(simulator, changes_n, rows, rows, np.ones(len(rows), dtype=bool))
    hypotheses = tuple(search(course))
    gap = np.sqrt(((changes_n - course.nominal) ** 2).mean())
    left = [
        *(single.rmse for single in singles),
        *(np.sqrt(((changes_n - h.prediction) ** 2).mean()) for h in hypotheses),
    ]
    return Judged(singles, hypotheses, float(min(left) / gap))


def rehearse(
    simulator: ChangeSimulator,
    scans: Sequence[Scan],
    measured: Judged,
    count: int,
    seed: int,
    tell: Callable[[float], None],
    workers: int = 1,
) -> Rehearsal:
    """Draw and diagnose `count` tables of each kind, with workshop scatter, noise and step.

    `tell` hears after every table which share is done. The counts are the same for any number of
    workers.
    """
    unexplained = dict.fromkeys(KINDS, 0)
    mistaken: Counter[tuple[str, str]] = Counter()
    named = 0
    cases = [(seed, kind, k) for kind in KINDS for k in range(count)]
    for done, found in enumerate(_each(simulator, scans, cases, workers), start=1):
        unexplained[found.kind] += found.least_left >= measured.least_left
        if found.kind == KINDS[0]:
            (effect,) = found.effects
            named += found.best == effect
            if found.best != effect:
                mistaken[effect, found.best] += 1
        tell(done / len(cases))
    return Rehearsal(count, unexplained, named, dict(mistaken))


class _Told(NamedTuple):
    """A simulated table: its true effects, what they leave, and whose number leaves least."""

    kind: str
    effects: list[str]
    least_left: float
    best: str


_Case = tuple[int, str, int]
_shared: list[tuple[ChangeSimulator, Sequence[Scan]]] = []


def _each(
    simulator: ChangeSimulator, scans: Sequence[Scan], cases: Sequence[_Case], workers: int
) -> Iterator[_Told]:
    if workers == 1:
        yield from (_told(simulator, scans, case) for case in cases)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        workers, context, initializer=_share, initargs=(simulator, scans)
    ) as pool:
        yield from pool.map(_told_by_worker, cases)


def _share(simulator: ChangeSimulator, scans: Sequence[Scan]) -> None:
    _shared.append((simulator, scans))


def _told_by_worker(case: _Case) -> _Told:
    return _told(*_shared[0], case)


def _told(simulator: ChangeSimulator, scans: Sequence[Scan], case: _Case) -> _Told:
    seed, kind, k = case
    rng = np.random.default_rng([seed, KINDS.index(kind), k])
    effects, changes_n = _table(simulator, scans, kind, rng)
    while not np.isfinite(changes_n).all():  # two effects with which no arm is at rest
        effects, changes_n = _table(simulator, scans, kind, rng)
    judged = judge(simulator, scans, changes_n)
    best = min(judged.singles, key=lambda s: s.held_out_rmse).number.effect
    return _Told(kind, effects, judged.least_left, best)


def read_rehearsal(path: Path) -> Rehearsal:
    """Counts from a file that `write_rehearsal` made."""
    said = json.loads(path.read_text(encoding="utf-8"))
    mistaken = {(truth, taken): count for truth, taken, count in said.pop("mistaken")}
    return Rehearsal(mistaken=mistaken, **said)


def write_rehearsal(path: Path, rehearsal: Rehearsal) -> None:
    """Write counts, so that who wants the verdict need not rehearse."""
    said = asdict(rehearsal)
    said["mistaken"] = [[*names, count] for names, count in sorted(rehearsal.mistaken.items())]
    path.write_text(json.dumps(said, indent=1) + "\n", encoding="utf-8")


def _rate(hits: int, count: int) -> float:
    """Laplace's rule, so that what was never seen is not impossible."""
    return (hits + 1) / (count + 2)


def _table(
    simulator: ChangeSimulator, scans: Sequence[Scan], kind: str, rng: np.random.Generator
) -> tuple[list[str], Array]:
    nominal = simulator.predict([{}])[0]
    variant = _scatter(simulator, rng)
    if kind == KINDS[2]:
        return [], simulator.measured(variant, rng, _unlisted(nominal.shape, rng))
    effects: list[str] = []
    while len(effects) < 1 + KINDS.index(kind):
        effect = str(rng.choice(sorted({s.number.effect for s in scans} - set(effects))))
        drawn = _of_effect([s for s in scans if s.number.effect == effect], nominal, rng)
        if drawn is not None:
            effects.append(effect)
            variant = {**variant, **drawn}
    return effects, simulator.measured(variant, rng)


def _scatter(simulator: ChangeSimulator, rng: np.random.Generator) -> Assignment:
    return {
        term: float(rng.normal(0.0, parameter.typical))
        for candidate in simulator.tolerances
        for place in candidate.places
        for term, parameter in zip(candidate.terms(place), candidate.parameters, strict=True)
    }


def _of_effect(
    scans: Sequence[Scan], nominal: Array, rng: np.random.Generator
) -> Assignment | None:
    """A place and a value, between those that were scanned, that make a gap of a fit size."""
    for _ in range(30):
        found = scans[int(rng.integers(len(scans)))]
        gap = np.sqrt(((found.predicted - nominal) ** 2).mean(axis=(1, 2)))
        fit = np.flatnonzero((gap >= SMALLEST_N) & (gap <= LARGEST_N))
        if len(fit):
            at = float(rng.choice(fit)) + rng.uniform(-0.5, 0.5)
            value = np.interp(at, np.arange(len(found.values)), found.values)
            return found.number.at(float(value))
    return None


def _unlisted(shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Any pattern of cables and load points, in proportion to the load: half of them internal.

    Rows are those of Table II: three load points with one load, then with twice as much.
    """
    points = shape[0] // 2
    pattern = rng.normal(size=(points, shape[1]))
    if rng.random() < 0.5:  # cables of one segment tighten alike
        pattern = np.repeat(rng.normal(size=(points, shape[1] // 3)), 3, axis=1)
    beyond = np.concatenate([pattern, 2.0 * pattern])
    return beyond * rng.uniform(SMALLEST_N, LARGEST_N) / np.sqrt((beyond**2).mean())
