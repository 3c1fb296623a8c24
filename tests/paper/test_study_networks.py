"""The study of networks says what was found, whatever that is."""

import pytest
from network_findings import PLAN, WORSE, made_up

from cablesense_gap.report.style import style
from cablesense_paper import network_trials
from cablesense_paper.network_findings import FULL, QUICK
from cablesense_paper.studies import networks
from cablesense_paper.studies.networks import said_of

pytestmark = pytest.mark.slow  # draws


@pytest.fixture(scope="module")
def poor():
    with style():
        return said_of(made_up(50.0))


@pytest.fixture(scope="module")
def good():
    with style():
        return said_of(made_up(1.0))


def test_every_shape_has_a_row(good):
    assert [row[:3] for row in good.tables[0].rows] == list(PLAN.shapes)
    timed = [row for row in good.tables[0].rows if row[-1] != "–"]
    assert {row[1] for row in timed} == {PLAN.compared_depth}


def test_networks_that_learnt_next_to_nothing_are_not_praised(poor):
    assert poor.lead.startswith("No decoupled network tried here")
    forces = [c for c in poor.comparisons if c.what.endswith("force error")]
    assert [c.agreement for c in forces] == ["no", "no"]


def test_the_smallest_networks_that_reach_the_paper_are_named(good):
    assert "have 2 layers of 8 each, 4,800 parameters in all." in good.lead
    assert all(architecture in good.lead for architecture in WORSE)


def test_architectures_agree_with_the_paper_where_their_errors_do(good):
    apart, together, stages, *little = good.comparisons
    assert [c.agreement for c in (apart, together, stages)] == ["yes", "yes", "no"]
    assert apart.ours == "×0.50 wrong contacts, ×0.50 direction, ×0.50 force"
    assert together.ours.startswith("33% of the parameters, 100% of the time; ×2.00")
    assert [c.agreement for c in little] == ["yes"] * 4


def test_the_papers_figures_close_the_table_of_its_amount_of_data(good):
    assert good.tables[1].rows[-1] == ("the paper", "over 98", 5.96, 9.97, 14.26)
    assert len(good.tables[1].rows) == 1 + len(PLAN.paper_poses)


@pytest.mark.parametrize(("quick", "plan"), [(True, QUICK), (False, FULL)], ids=["quick", "full"])
def test_a_quick_run_carries_out_the_quick_plan(quick, plan, monkeypatch):
    monkeypatch.setattr(network_trials, "explore", lambda plan, tell: plan)
    monkeypatch.setattr(networks, "said_of", lambda found: found)
    assert networks.run(quick, lambda share: None) is plan
