"""What makes the gap between Table II's physical rows and this project's simulation of them.

54 measured changes of tension: nine cables, 1 and 2 kg on each of three segments. Explanations are
fitted to some rows and judged on others; simulated tables that are diagnosed in the same way give
the probability.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.gap_size import gap_size, rmse_interval_n
from cablesense_gap.internal_forces import internal_n, moments_n_m
from cablesense_gap.one_number import (
    Explained,
    OneNumber,
    Scan,
    explain,
    held_out_of_best,
    most_change,
    numbers_of,
    scan,
)
from cablesense_gap.simulator import Array, Term
from cablesense_gap.table2.rehearsal import (
    SHIPPED,
    Judged,
    Rehearsal,
    judge,
    read_rehearsal,
    rehearse,
)
from cablesense_gap.tension_changes import ChangeSimulator, TensionChanges
from cablesense_gap.verdict import UNKNOWN, Candidate, Verdict, Where
from cablesense_msgs_py.errors import CableSenseError
from cablesense_sim.arm import Arm
from cablesense_sim.arm_files import open_arm
from cablesense_training.evaluation.table2 import read_table2

ARM = "cdsm_table2"
STEP_N = 0.1813
SEED = 1
FOLDS = {
    "one row": np.arange(6),
    "one load point": np.array([0, 1, 2, 0, 1, 2]),
    "one load level": np.array([0, 0, 0, 1, 1, 1]),
}
"""Rows held out together; the table has three load points with 1 kg, then with 2 kg."""

INDEPENDENT = 5.4
"""What the 54 numbers count for among explanations that all leave most: a tenth, as the search has
it (`diagnosis.evidence.CORRELATION`)."""


@dataclass(frozen=True)
class Findings:
    """All that the report tells.

    Attributes:
        arm: of the table.
        changes: the physical rows.
        nominal_n, paper_n: (6, 9) this project's and the paper's simulated rows.
        floor_n: what noise and step leave of one change.
        internal_n: (6, 9) part of the gap that carries no moment.
        moments: (6, 3) pitch moments about each joint over those of the known load; NaN where
            there are none.
        blind: effects that no change in this table could show, with the most that they do, N.
        singles: for each held-out scheme, the best number of each effect, the best first.
        any_single_n: for each scheme, what is left where the effect is chosen on the fit rows too.
        proportional_n: (6, 9) each row as the other level's row tells it, in proportion.
        judged, rehearsal: see there.
        verdict: of it all.
        command: that made this.
    """

    arm: Arm
    changes: TensionChanges
    nominal_n: Array
    paper_n: Array
    floor_n: float
    internal_n: Array
    moments: Array
    blind: dict[str, float]
    singles: dict[str, tuple[Explained, ...]]
    any_single_n: dict[str, float]
    proportional_n: Array
    judged: Judged
    rehearsal: Rehearsal
    verdict: Verdict
    command: str

    @property
    def gap_n(self) -> Array:
        """(6, 9) measured less simulated."""
        return self.changes.changes_n - self.nominal_n


def diagnose_table(
    tables: int | None,
    command: str,
    tell: Callable[[float], None] = lambda done: None,
    workers: int = 1,
) -> Findings:
    """Everything from the table to the verdict.

    Args:
        tables: of each kind that are simulated and diagnosed for the probability; None takes the
            counts that ship with the package.
        command: that makes the findings again.
        tell: hears which share is done.
        workers: processes that diagnose the simulated tables.

    Raises:
        CableSenseError: the verdict is no longer `unknown`, so that the words do not hold.
    """
    began = time.monotonic()
    arm, physical, paper_n = open_arm(ARM), table("physical"), table("simulated").changes_n
    everything = ChangeSimulator(arm, physical)
    nominal = everything.predict([{}])[0]
    scans, blind = _scans(everything, nominal)
    seen = {found.number.effect for found in scans}
    simulator = ChangeSimulator(arm, physical, seen)
    measured = physical.changes_n
    judged = judge(simulator, scans, measured)
    tell(0.1 if tables else 0.6)
    if tables:
        rehearsal = rehearse(
            simulator, scans, judged, tables, SEED, lambda done: tell(0.1 + 0.9 * done), workers
        )
    else:
        rehearsal = read_rehearsal(SHIPPED)
    singles = {name: _best_of_each(scans, measured, fold) for name, fold in FOLDS.items()}
    proportional = np.concatenate([0.5 * measured[3:], 2.0 * measured[:3]])
    expected = moments_n_m(arm, nominal)[:, ::2]
    carried = moments_n_m(arm, measured)[:, ::2]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(np.abs(expected) > 1e-3, carried / expected, np.nan)
    found = Findings(
        arm=arm,
        changes=physical,
        nominal_n=nominal,
        paper_n=paper_n,
        floor_n=simulator.floor,
        internal_n=internal_n(arm, measured - nominal),
        moments=ratio,
        blind=blind,
        singles=singles,
        any_single_n={
            name: float(np.sqrt(held_out_of_best(scans, measured, fold).sum() / measured.size))
            for name, fold in FOLDS.items()
        },
        proportional_n=proportional,
        judged=judged,
        rehearsal=rehearsal,
        verdict=_verdict(simulator, physical, nominal, judged, rehearsal, proportional),
        command=command,
    )
    seconds = round(time.monotonic() - began, 1)
    return replace(found, verdict=found.verdict.model_copy(update={"seconds": seconds}))


def table(source: str) -> TensionChanges:
    """The `physical` or `simulated` rows of Table II as changes under hung loads."""
    rows = [row for row in read_table2() if row.source == source]
    weight = np.array([row.weight_n for row in rows])
    return TensionChanges(
        name=f"table2_{source}",
        load_segment=np.array([row.segment for row in rows]),
        load_n=weight[:, None] * np.array([0.0, 0.0, -1.0]),
        changes_n=np.stack([row.tension_difference_n for row in rows]),
    )


def _scans(simulator: ChangeSimulator, nominal: Array) -> tuple[list[Scan], dict[str, float]]:
    """All numbers of the effects that can be seen, and the others with the most they do, N."""
    seen: list[Scan] = []
    blind = {}
    for candidate in simulator.candidates:
        scans = [scan(simulator, number) for number in numbers_of(candidate)]
        most = max(most_change(found, nominal) for found in scans)
        if most <= simulator.floor:
            blind[candidate.effect] = most
            continue
        seen += scans
        if candidate.effect == "sensor_gain":  # which is also a load heavier than believed
            places = tuple(Term("sensor_gain", place, "gain") for place in candidate.places)
            (gain,) = candidate.parameters
            seen.append(scan(simulator, OneNumber(places, gain.low, gain.high)))
    return seen, blind


def _best_of_each(
    scans: Sequence[Scan], measured: Array, fold: NDArray[np.int64]
) -> tuple[Explained, ...]:
    """The best number of each effect; one value at all cables counts beside those at one."""
    every = defaultdict(list)
    for found in scans:
        several = len(found.number.terms) > 1
        every[found.number.effect, several].append(explain(found, measured, fold))
    best = [min(group, key=lambda e: round(e.held_out_rmse, 3)) for group in every.values()]
    return tuple(sorted(best, key=lambda e: e.held_out_rmse))


def _verdict(
    simulator: ChangeSimulator,
    physical: TensionChanges,
    nominal: Array,
    judged: Judged,
    rehearsal: Rehearsal,
    proportional: Array,
) -> Verdict:
    """Unknown while that is the most probable; the words of the report are about that alone."""
    if rehearsal.probability <= 0.5:
        raise CableSenseError(
            f"listed effects leave {judged.least_left:.0%} of the gap, and something unlisted is "
            f"only {rehearsal.probability:.0%} probable: the words of the report no longer hold"
        )
    gap = physical.changes_n - nominal
    rows = np.arange(len(gap))
    by_cable = np.sqrt((gap**2).mean(0))
    return Verdict(
        effects=(UNKNOWN,),
        probability=rehearsal.probability,
        ambiguity_group=(UNKNOWN,),
        where=Where(
            cables=tuple(
                f"cable_{i + 1}" for i in np.flatnonzero(by_cable > 1.1 * np.sqrt((gap**2).mean()))
            ),
            regimes=("in proportion to the load",),
        ),
        gap=gap_size(gap, physical.changes_n - proportional, rows, simulator.floor),
        candidates=_candidates(judged, rehearsal, physical.changes_n - proportional),
        recording=physical.name,
        arm=ARM,
    )


def _candidates(judged: Judged, rehearsal: Rehearsal, flexible_n: Array) -> tuple[Candidate, ...]:
    """Listed explanations share what the unlisted leaves, the more the less they leave."""
    count = np.full(6, 9.0)
    squares = {h.effects or ("none",): h.squares for h in judged.hypotheses}
    for single in judged.singles:
        effects = (single.number.effect,)
        if effects not in squares or single.squares.sum() < squares[effects].sum():
            squares[effects] = single.squares
    weight = {e: float(s.sum()) ** (-0.5 * INDEPENDENT) for e, s in squares.items()}
    share = (1.0 - rehearsal.probability) / sum(weight.values())
    listed = [
        _candidate(effects, left, count, share * weight[effects])
        for effects, left in squares.items()
    ]
    unlisted = _candidate((UNKNOWN,), (flexible_n**2).sum(-1), count, rehearsal.probability)
    return tuple(sorted([unlisted, *listed], key=lambda c: -c.probability))


def _candidate(
    effects: tuple[str, ...], squares: Array, count: Array, probability: float
) -> Candidate:
    return Candidate(
        effects=effects,
        held_out_rmse_n=float(np.sqrt(squares.sum() / count.sum())),
        probability=probability,
        held_out_ci95_n=rmse_interval_n(squares, count),
    )
