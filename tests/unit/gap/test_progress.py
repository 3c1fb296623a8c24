"""What a diagnosis shows while it works: a bar for each stage, and a time that is told once."""

from __future__ import annotations

import io
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from cablesense_gap.diagnosis.duration import STAGES, expected_s, may_depend_on_history
from cablesense_gap.diagnosis.problem import Past
from cablesense_gap.simulator import Candidate
from cablesense_ros.cli.options import diagnosis_progress, duration_text
from tests.helpers.gap_problem import size


def test_every_stage_has_a_bar_of_its_own_and_none_states_a_time_left():
    console = Console(file=io.StringIO(), force_terminal=True, width=120)
    with diagnosis_progress(console) as progress:
        progress.show("predicting the nominal arm", 0.0)
        progress.announce(185.0)
        for done in (0.1, 0.5, 0.8, 0.96, 1.0):
            progress.show("payload + sensor_gain", done)
    text = console.file.getvalue()
    assert "This takes about 3 min." in text
    for name, _ in STAGES:
        assert name in text
    assert "left" not in text


@pytest.mark.parametrize(
    ("seconds", "text"), [(3.0, "10 s"), (34.0, "30 s"), (130.0, "2 min"), (1800.0, "30 min")]
)
def test_a_time_has_the_digits_that_are_known(seconds, text):
    assert duration_text(seconds) == text


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
