"""One number over its range: what was planted is found, and held-out rows are held out."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.simulator import Candidate, Term
from cablesense_paper.tension_changes import (
    OneNumber,
    explain,
    held_out_of_best,
    most_change,
    numbers_of,
    scan,
)
from cablesense_sim.effects.effect import Parameter

GAIN, PLAY = Term("gain", "arm", "gain"), Term("play", "arm", "play_m")
ROWS = np.arange(1.0, 7.0)
BY_ROW = np.arange(6)


class Lever:
    """Six rows of two channels; the gain scales both, play takes from the last row alone."""

    floor = 0.01
    tolerances = ()
    candidates = (
        Candidate("gain", ("arm",), (Parameter("gain", "1", -0.5, 0.5, 0.1, "scale"),)),
        Candidate(
            "play",
            ("arm", "joint_1"),
            (
                Parameter("play_m", "m", 0.0, 2.0, 0.1, "lost"),
                Parameter("start", "1", -1.0, 1.0, 0.5, "past", role="shape", trials=(-0.5, 0.5)),
            ),
        ),
    )

    def predict(self, variants):
        return np.stack([self._one(variant) for variant in variants])

    def _one(self, variant):
        readings = np.stack([ROWS, -2.0 * ROWS], axis=-1) * (1.0 + variant.get(GAIN, 0.0))
        if variant.get(PLAY, 0.0) > 1.5:
            return np.full_like(readings, np.nan)
        readings[-1] -= max(variant.get(PLAY, 0.0) - 0.5, 0.0)
        return readings


LEVER = Lever()
NOMINAL = LEVER.predict([{}])[0]
GAIN_NUMBER = OneNumber((GAIN,), -0.5, 0.5)
PLAY_NUMBER = OneNumber((PLAY,), 0.0, 2.0)


@pytest.mark.parametrize(("low", "high"), [(-0.5, 0.5), (0.0, 2.0), (-1.0, 3.0)])
def test_values_span_the_range_with_zero_among_them(low, high):
    values = OneNumber((GAIN,), low, high).values()
    assert values[0] == low
    assert values[-1] == high
    assert 0.0 in values
    assert (np.diff(values) > 0.0).all()


@settings(max_examples=30, deadline=None)
@given(st.floats(-0.45, 0.45))
def test_a_planted_gain_is_found_on_rows_that_were_held_out(planted):
    found = explain(scan(LEVER, GAIN_NUMBER), LEVER.predict([{GAIN: planted}])[0], BY_ROW)
    assert found.value == pytest.approx(planted, abs=0.013)
    gap = np.sqrt(((planted * NOMINAL) ** 2).mean())
    assert found.held_out_rmse <= max(0.1, 0.3 * gap)


def test_an_effect_that_only_begins_at_some_size_is_not_missed():
    scanned = scan(LEVER, PLAY_NUMBER)
    assert scanned.values[-1] <= 1.5  # beyond, nothing can be simulated
    assert most_change(scanned, NOMINAL) > 0.2
    found = explain(scanned, LEVER.predict([{PLAY: 1.2}])[0], BY_ROW)
    assert found.value == pytest.approx(1.2, abs=0.05)
    # the one row that shows it cannot be told by the others, which take it to be absent
    assert found.rmse < 0.05
    np.testing.assert_allclose(found.squares[:-1], 0.0, atol=0.01)
    assert found.squares[-1] == pytest.approx(2 * 0.7**2, rel=0.01)


def test_where_nothing_changes_the_number_is_zero():
    assert explain(scan(LEVER, PLAY_NUMBER), NOMINAL, BY_ROW).value == 0.0


def test_the_number_itself_is_chosen_without_the_rows_that_judge_it():
    readings = LEVER.predict([{GAIN: 0.2}])[0]
    scans = [scan(LEVER, PLAY_NUMBER), scan(LEVER, GAIN_NUMBER)]
    assert held_out_of_best(scans, readings, BY_ROW).sum() < 0.1
    only = LEVER.predict([{PLAY: 1.2}])[0]
    assert held_out_of_best(scans, only, BY_ROW)[-1] == pytest.approx(2 * 0.7**2, rel=0.01)


def test_a_candidate_has_a_number_for_each_place_and_each_start_of_its_shape():
    gain, play = (list(numbers_of(candidate)) for candidate in LEVER.candidates)
    assert [number.terms for number in gain] == [(GAIN,)]
    assert len(play) == 4
    held = Term("play", "joint_1", "start")
    assert [n.at(0.3)[held] for n in play if held in n.held] == [-0.5, 0.5]
    assert play[0].at(0.3)[PLAY] == 0.3
    assert play[0].effect == "play"


def test_one_value_may_sit_in_several_places():
    both = OneNumber((GAIN, PLAY), -0.1, 0.1)
    assert both.at(0.1) == {GAIN: 0.1, PLAY: 0.1}
