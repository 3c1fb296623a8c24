"""The causes of the gap between Table II's physical rows and this project's simulation.

54 measured changes of tension: nine cables, 1 and 2 kg on each of three segments. Hypotheses are
fitted to some rows and judged on others. No calibration made on long recordings of another arm
holds here, so they get no probability: listed effects are compared with a law that knows nothing
but that changes are in proportion to the load.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cablesense_base import Array
from cablesense_gap.diagnosis.problem import Hypothesis, prepare
from cablesense_gap.diagnosis.search import search
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import NONE
from cablesense_sim.arm import Arm, open_arm
from cablesense_training.evaluation.comparison import read_table2
from paper.study import PaperError
from paper.tension_changes import (
    ChangeSimulator,
    Explained,
    OneNumber,
    Scan,
    TensionChanges,
    explain,
    internal_n,
    numbers_of,
    scan,
)

ARM = "cdsm_table2"
STEP_N = 0.1813


@dataclass(frozen=True)
class TableDiagnosis:
    """All that the report states of the table's physical rows, `changes`.

    Attributes:
        nominal_n, paper_n: (6, 9) this project's and the paper's simulated rows.
        blind: effects that no change in this table could show, with the most that they do, N.
        floor_n: error of a change by noise and rounding, N.
        singles: the table under every number alone that can be seen.
        hypotheses: those of the diagnosis' search.
    """

    arm: Arm
    changes: TensionChanges
    nominal_n: Array
    paper_n: Array
    blind: dict[str, float]
    floor_n: float
    singles: tuple[Explained, ...]
    hypotheses: tuple[Hypothesis, ...]

    @property
    def gap_n(self) -> Array:
        """(6, 9) measured less simulated."""
        return self.changes.changes_n - self.nominal_n

    @property
    def internal_n(self) -> Array:
        """(6, 9) the part of the gap that carries no moment."""
        return internal_n(self.arm, self.gap_n)

    @property
    def proportional_n(self) -> float:
        """RMS that each row leaves of the one of the other load, in proportion, N."""
        measured = self.changes.changes_n
        predicted = np.concatenate([0.5 * measured[3:], 2.0 * measured[:3]])
        return float(np.sqrt(((measured - predicted) ** 2).mean()))

    @property
    def held_out_n(self) -> dict[tuple[str, ...], float]:
        """RMS that listed effects leave of rows that they were not fitted to, N, least first."""
        left_n = {
            hypothesis.effects or (NONE,): hypothesis.held_out_rmse
            for hypothesis in self.hypotheses
        }
        for single in self.singles:
            effects = (single.number.effect,)
            left_n[effects] = min(left_n.get(effects, np.inf), single.held_out_rmse)
        return dict(sorted(left_n.items(), key=lambda each: each[1]))


def diagnose_table(progress: Callable[[float], None] = lambda done: None) -> TableDiagnosis:
    """Everything from the table to its hypotheses; `progress` receives the share that is done.

    Raises:
        PaperError: a listed effect leaves less than the law of proportion, so that the text of the
            report does not hold.
    """
    arm = open_arm(ARM)
    physical = table("physical")
    everything = ChangeSimulator(arm, physical)
    nominal = everything.predict([{}])[0]
    scans, blind = _scans(everything, nominal)
    progress(0.5)
    simulator = ChangeSimulator(arm, physical, {scanned.number.effect for scanned in scans})
    rows = np.arange(len(physical.changes_n))
    all_rows = np.ones(len(rows), dtype=bool)
    diagnosis = TableDiagnosis(
        arm=arm,
        changes=physical,
        nominal_n=nominal,
        paper_n=table("simulated").changes_n,
        blind=blind,
        floor_n=simulator.floor,
        singles=tuple(explain(each, physical.changes_n) for each in scans),
        hypotheses=tuple(search(prepare(simulator, physical.changes_n, rows, rows, all_rows))),
    )
    best, left_n = next(iter(diagnosis.held_out_n.items()))
    if left_n <= diagnosis.proportional_n:
        raise PaperError(
            f"{' and '.join(best)} leaves {left_n:.2f} N of the gap, the law of proportion "
            f"{diagnosis.proportional_n:.2f} N: the text of the report no longer holds"
        )
    return diagnosis


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
        most = max(float(scanned.rms_n(nominal).max(initial=0.0)) for scanned in scans)
        if most <= simulator.floor:
            blind[candidate.effect] = most
            continue
        seen += scans
        if candidate.effect == "sensor_gain":  # which is also a load heavier than believed
            places = tuple(Term("sensor_gain", place, "gain") for place in candidate.places)
            (gain,) = candidate.parameters
            seen.append(scan(simulator, OneNumber(places, gain.low, gain.high)))
    return seen, blind


def best_of_each(singles: Sequence[Explained]) -> list[Explained]:
    """The best number of each effect, best first; one value at all cables counts separately."""
    by_effect = defaultdict(list)
    for single in singles:
        by_effect[single.number.effect, len(single.number.terms) > 1].append(single)
    best = [min(group, key=lambda e: round(e.held_out_rmse, 3)) for group in by_effect.values()]
    return sorted(best, key=lambda e: e.held_out_rmse)
