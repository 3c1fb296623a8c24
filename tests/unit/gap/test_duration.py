"""The time that a search will take, which a diagnosis tells once."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cablesense_gap.diagnosis.duration import expected_s, may_depend_on_history
from cablesense_gap.diagnosis.problem import Past
from cablesense_gap.simulator import Candidate
from tests.helpers.gap_problem import size


class Timed:
    """A simulator with a candidate that remembers, or with none."""

    def __init__(self, remembers: bool) -> None:
        one = Candidate("friction", ("arm",), (size("amount"),), history_dependent=remembers)
        self.candidates = (one,)
        self.asked = 0

    def predict(self, variants):
        self.asked += 1
        return np.zeros((len(variants), 4, 1))


@pytest.mark.parametrize("remembers", [False, True])
def test_the_time_is_that_of_the_simulations_that_are_needed(remembers):
    problem = SimpleNamespace(
        simulator=Timed(remembers),
        subsample=None,
        past=None,
        readings=np.ones((4, 1)),
        nominal=np.zeros((4, 1)),
        floor=0.1,
    )
    one = expected_s(problem, 2.0, workers=1)
    two = expected_s(problem, 2.0, workers=2)
    assert two < one
    assert (problem.simulator.asked > 0) == remembers
    problem.past = Past(rms=1e-6, rows=np.ones(4, dtype=bool))
    assert not may_depend_on_history(problem, problem.nominal)
