"""The gap of Table II: a verdict of unknown, its probability by rehearsal, and its report."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paper_studies import compared, result_of

from cablesense_gap.simulator import Term
from cablesense_gap.verdict import UNKNOWN
from examples.paper import table_2_gap, tension_changes
from examples.paper.studies.sim_to_real import (
    figures_of,
    numbers_of,
    shares,
)
from examples.paper.study import PAPER, Agreement
from examples.paper.table_2_gap import (
    KINDS,
    PRIOR_UNLISTED,
    REHEARSAL,
    Judged,
    Rehearsal,
    diagnose_table,
    rehearse,
    table,
)
from examples.paper.tension_changes import OneNumber, Scan, explain


def counted(count, one, two, unlisted):
    unexplained = dict(zip(KINDS, (one, two, unlisted), strict=True))
    return Rehearsal(count=count, unexplained=unexplained, named=0)


@given(st.integers(1, 200))
def test_counts_alike_for_all_kinds_leave_the_prior(count):
    every = counted(count, count, count, count).probability
    assert every == pytest.approx(PRIOR_UNLISTED, abs=0.2 / count)


class Unloaded:
    """A simulator of six rows and nine cables, all of them zero."""

    tolerances = ()

    def predict(self, variants):
        return np.zeros((len(variants), 6, 9))

    def measured(self, variant, rng, beyond_n=0.0):
        return rng.normal(0.0, 0.01, (6, 9)) + beyond_n


def test_tables_of_all_kinds_are_drawn_judged_and_counted(monkeypatch):
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
        large = np.abs(changes_n).max() > 0.3
        singles = tuple(explain(s, changes_n, np.arange(6)) for s in scans)
        return Judged(singles, (), float(large))

    monkeypatch.setattr(table_2_gap, "judge", judge)
    progress = []
    found = rehearse(Unloaded(), scans, Judged((), (), 0.5), 4, 1, progress.append)
    assert found.unexplained[KINDS[2]] == 4
    assert found.named + sum(times for *_, times in found.mistaken) == 4
    assert Rehearsal.model_validate_json(found.model_dump_json()) == found
    assert progress == sorted(progress)
    assert progress[-1] == 1.0


def test_the_table_is_read_as_hung_loads():
    changes = table("physical")
    assert changes.changes_n.shape == (6, 9)
    assert list(changes.load_segment) == [1, 2, 3, 1, 2, 3]
    np.testing.assert_allclose(changes.load_n[:, 2], [-9.81] * 3 + [-19.62] * 3)


@pytest.fixture(scope="module")
def found():
    """With the counts that ship, and ranges gone through more coarsely."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tension_changes, "VALUES", 21)
        return diagnose_table(0)


@pytest.fixture(scope="module")
def result(found):
    return result_of("sim_to_real", lambda _: (numbers_of(found), figures_of(found)))


@pytest.mark.slow
def test_the_verdict_is_unknown_by_the_counts_that_ship(found):
    assert found.verdict.effects == (UNKNOWN,)
    assert found.rehearsal == Rehearsal.model_validate_json(REHEARSAL.read_text())
    assert found.verdict.probability == found.rehearsal.probability > 0.5
    assert sum(c.probability for c in found.verdict.candidates) == pytest.approx(1.0)


@pytest.mark.slow
def test_a_law_in_proportion_leaves_less_than_any_listed_effect(found):
    gap = found.verdict.gap
    listed = [c for c in found.verdict.candidates if c.effects != (UNKNOWN,)]
    assert gap.floor_n < gap.after_n < min(c.held_out_rmse_n for c in listed)
    assert max(c.held_out_rmse_n for c in listed) == pytest.approx(gap.before_n, rel=1e-2)


@pytest.mark.slow
def test_internal_forces_are_part_of_the_gap_and_bend_no_joint(found):
    inner = found.internal_n.reshape(6, 3, 3)
    np.testing.assert_allclose(inner, inner[:, :, :1] * np.ones(3), atol=1e-9)
    assert (inner**2).sum() < (found.gap_n**2).sum()


@pytest.mark.slow
def test_shares_of_the_gap_add_up(found):
    assert sum(shares(found).values()) == pytest.approx(1.0)
    assert all(share > 0.0 for share in shares(found).values())


@pytest.mark.slow
def test_the_report_gives_verdict_leads_and_the_next_experiment(result):
    assert result.lead.startswith("Verdict: unknown (")
    *_, slack, _, paper, following = result.notes
    assert "cable 6 goes slack" in slack
    assert "-1.92, +0.37" in paper
    assert following.startswith("What to measure next. Hang")


@pytest.mark.slow
def test_the_gap_is_smaller_than_the_papers(result):
    ours, theirs, agreement = compared(result)["sim-to-real gap, largest", PAPER]
    assert ours < theirs == 5.98
    assert agreement is Agreement.YES
