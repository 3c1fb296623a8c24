"""The words on Table II say what the numbers say."""

from dataclasses import replace

import pytest
from table2_diagnosis import diagnosed

from cablesense_paper.table_2_text import (
    best_listed_n,
    no_worse,
    paper_rows,
    ranked_singles,
    readme,
    reasons,
    shares,
    slack_cable,
    worded,
)

pytestmark = pytest.mark.slow  # the diagnosis behind them


def test_shares_of_the_gap_add_up():
    assert sum(part.share for part in shares(diagnosed())) == pytest.approx(1.0)
    assert all(part.share > 0.0 for part in shares(diagnosed()))


def test_the_best_number_comes_first_and_is_no_worse_than_itself():
    found = diagnosed()
    left = [single.held_out_rmse for single in ranked_singles(found)]
    assert left[0] == pytest.approx(min(left), abs=0.005)
    assert len(no_worse(found)) >= 1
    assert best_listed_n(found) <= left[0]


def test_the_verdict_is_worded():
    verdict = worded(diagnosed()).verdict
    assert verdict.why == reasons(diagnosed())
    assert "Hang" in verdict.next_experiment


def test_a_verdict_without_a_pair_says_that_none_helps():
    found = diagnosed()
    alone = tuple(h for h in found.judged.hypotheses if len(h.effects) < 2)
    said = reasons(replace(found, judged=replace(found.judged, hypotheses=alone)))
    assert any("No two effects" in sentence for sentence in said)


def test_the_leads_name_the_slack_cable_and_the_papers_constant():
    assert "cable 6 goes slack" in slack_cable(diagnosed())
    assert "-1.92, +0.37" in paper_rows(diagnosed())


def test_the_page_in_markdown_has_all_six_loads():
    text = readme(diagnosed())
    assert text.startswith("# The gap of Table II")
    assert text.count(" kg on segment ") >= 6
