"""What a rehearsal counts, and the probability that follows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_gap.simulator import Term
from cablesense_paper import table_2_gap as rehearsing
from cablesense_paper.table_2_gap import (
    KINDS,
    PRIOR_UNLISTED,
    Judged,
    Rehearsal,
    read_rehearsal,
    rehearse,
    write_rehearsal,
)


def counted(count, one, two, unlisted):
    return Rehearsal(count, dict(zip(KINDS, (one, two, unlisted), strict=True)), 0, {})


@given(st.integers(1, 200))
def test_counts_alike_for_all_kinds_leave_what_was_expected_beforehand(count):
    every = counted(count, count, count, count).probability
    assert every == pytest.approx(PRIOR_UNLISTED, abs=0.2 / count)


def test_the_more_of_the_unlisted_are_left_the_more_probable_it_is():
    found = [counted(40, 0, 0, k).probability for k in range(41)]
    assert found == sorted(found)
    assert 0.0 < found[0] < found[-1] < 1.0


def test_counts_come_back_from_a_file(tmp_path):
    whole = Rehearsal(3, dict.fromkeys(KINDS, 1), 2, {("payload", "sensor_gain"): 1})
    write_rehearsal(tmp_path / "counts.json", whole)
    assert read_rehearsal(tmp_path / "counts.json") == whole


class Even:
    """A simulator of six rows and nine cables, all of them nothing."""

    tolerances = ()

    def predict(self, variants):
        return np.zeros((len(variants), 6, 9))

    def measured(self, variant, rng, beyond_n=0.0):
        return rng.normal(0.0, 0.01, (6, 9)) + beyond_n


def test_tables_of_all_kinds_are_drawn_judged_and_told_of(monkeypatch):
    from cablesense_paper.tension_changes import OneNumber, Scan, explain

    values = np.linspace(-1.0, 1.0, 21)
    scans = [
        Scan(
            OneNumber((Term(effect, "arm", "gain"),), -1.0, 1.0),
            values,
            values[:, None, None] * np.full((6, 9), size),
        )
        for effect, size in (("sensor_gain", 2.0), ("payload", -3.0))
    ]

    def judge(simulator, scans, changes_n):
        fold = np.arange(6)
        large = np.abs(changes_n).max() > 0.3
        return Judged(tuple(explain(s, changes_n, fold) for s in scans), (), float(large))

    monkeypatch.setattr(rehearsing, "judge", judge)
    told = []
    found = rehearse(Even(), scans, Judged((), (), 0.5), 4, 1, told.append)
    assert found.unexplained[KINDS[2]] == 4
    assert 0 <= found.named <= 4
    assert told == sorted(told)
    assert told[-1] == 1.0
