"""A healthy recording, against which a diagnosis says what changed since then."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cablesense_base import Array
from cablesense_gap.diagnosis.gauss_newton import refine
from cablesense_gap.diagnosis.problem import Problem
from cablesense_gap.diagnosis.reference import Discrepancy, SmoothColumns, effect_columns
from cablesense_gap.pipeline import Expected, System, problem_of
from cablesense_gap.verdict import ReferenceGap


class Reference:
    """A machine as a recording shows it when healthy.

    Attributes:
        tolerances: of the machine.
        left: the gap of the nominal machine there, for the verdict.
    """

    def __init__(self, system: System) -> None:
        """`system` is the nominal machine with the reference."""
        problem = problem_of(system)
        none = refine(problem, {}, [[]])
        assert none is not None
        used, nominal = problem.used, problem.readings - problem.nominal
        self.tolerances = dict(none.tolerances)
        system = system.with_listed(self.tolerances)
        problem = replace(problem, simulator=system, nominal=system.predict([{}])[0])
        conditions = system.conditions()
        self._smooth = None if conditions is None else SmoothColumns.like(conditions)
        columns = {name: column[used] for name, column in self._columns(system, problem).items()}
        residual, trial = (problem.readings - problem.nominal)[used], problem.trial[used]
        found = Discrepancy(columns, residual * system.scale, problem.fold[trial])
        self._discrepancy = found
        before, left = nominal[used], residual - found.held_out / system.scale
        self.left = ReferenceGap(
            recording=system.recording_name,
            before_n=float(np.sqrt((before**2).mean())),
            left_n=float(np.sqrt((left**2).mean())),
            channels=system.channels(before, left),
        )

    def expected(self, system: System, problem: Problem) -> Expected:
        """In another recording, in its units; `system` has the reference's tolerances."""
        beyond, conditions = np.zeros_like(system.readings), system.conditions()
        if self._smooth is not None and conditions is not None:
            beyond = np.abs(system.compared_columns(self._smooth.beyond(conditions)))
        mean, deviation = self._discrepancy.of(self._columns(system, problem), beyond)
        deviation = np.maximum(deviation / system.scale, system.floor)
        floor = float(np.sqrt((deviation[system.counted] ** 2).mean()))
        return Expected(mean / system.scale, floor / deviation, floor)

    def _columns(self, system: System, problem: Problem) -> dict[tuple[str, ...], Array]:
        columns = {name: own * system.scale for name, own in effect_columns(problem).items()}
        conditions = system.conditions()
        if self._smooth is not None and conditions is not None:
            smooth = self._smooth.of(conditions)
            columns |= {name: system.compared_columns(own) for name, own in smooth.items()}
        return columns
