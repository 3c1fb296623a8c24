"""What the diagnosis works on: readings by trial, and the sensitivities to tolerances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.diagnosis.hypothesis import Hypothesis, excess
from cablesense_gap.simulator import Array, Simulator, Term

FOLDS = 5

_STRAIN = 1.0 / 3.0


@dataclass(frozen=True)
class Course:
    """One recording beside its simulator.

    Attributes:
        simulator: put through this very recording.
        readings: (R, C).
        trial: (R,) 0 to T - 1.
        fold: (T,) trials of one fold are held out together.
        used: (R,) rows that count.
        nominal: (R, C) prediction without any effect.
        tolerance_terms: of what a workshop leaves.
        tolerance_std: of each of them.
        tolerance_columns: (K, R, C) sensitivities, in standard deviations.
    """

    simulator: Simulator
    readings: Array
    trial: NDArray[np.int64]
    fold: NDArray[np.int64]
    used: NDArray[np.bool_]
    nominal: Array
    tolerance_terms: tuple[Term, ...]
    tolerance_std: Array
    tolerance_columns: Array

    @property
    def floor(self) -> float:
        """Root mean square of what the sensors add."""
        return self.simulator.floor

    @property
    def usual_strain(self) -> float:
        """Sum of the squares of all tolerances, in standard deviations, of a careful workshop."""
        return float(max(len(self.tolerance_terms), 1))

    def cost(self, mean_square: float, strain: float) -> float:
        """What is left beyond the floor, the dearer the farther tolerances have to be off.

        By this the search ranks explanations; the belief weighs both by calibrated powers.
        """
        strained = max(strain / self.usual_strain, 1.0)
        return float(excess(mean_square, self.floor) * strained**_STRAIN)

    def cost_of(self, hypothesis: Hypothesis) -> float:
        """That of what a hypothesis leaves on held-out trials."""
        return self.cost(hypothesis.held_out_rmse**2, hypothesis.strain)


def prepare(
    simulator: Simulator,
    readings: Array,
    trial: NDArray[np.int64],
    fold: NDArray[np.int64],
    used: NDArray[np.bool_],
) -> Course:
    """Predict the nominal mechanism and what each tolerance changes of it."""
    nominal = simulator.predict([{}])[0]
    terms = [
        (term, parameter.typical)
        for candidate in simulator.tolerances
        for place in candidate.places
        for term, parameter in zip(candidate.terms(place), candidate.parameters, strict=True)
    ]
    columns = [simulator.predict([{term: std}])[0] - nominal for term, std in terms]
    return Course(
        simulator=simulator,
        readings=readings,
        trial=np.unique(trial, return_inverse=True)[1],
        fold=fold,
        used=used,
        nominal=nominal,
        tolerance_terms=tuple(term for term, _ in terms),
        tolerance_std=np.array([std for _, std in terms]),
        tolerance_columns=np.array(columns).reshape(len(columns), *nominal.shape),
    )
