"""The exploration of networks, at a tiny size: what is asked is answered, whatever comes out."""

import pytest

from cablesense_gap.report.figure_style import style
from cablesense_paper.networks import trials
from cablesense_paper.studies import networks
from cablesense_paper.studies.networks import FULL, QUICK, Plan, explored

pytestmark = pytest.mark.slow  # trains and draws

TINY = Plan(
    depths=(1, 2),
    widths=(4, 8),
    compared_depth=2,
    seeds=(0,),
    samples=256,
    batch_size=64,
    epochs=1,
    test_samples=256,
    paper_poses=("straight", "random"),
    workers=1,
)


@pytest.fixture(scope="module")
def result():
    told = []
    with pytest.MonkeyPatch.context() as patch, style():
        patch.setattr(trials, "answer_us", lambda shape, arm: 20.0 + shape.width)
        patch.setattr(networks, "PAPER_SAMPLES", 128)
        found = explored(TINY, told.append)
    assert told == sorted(told)
    return found


def test_every_shape_has_a_row(result):
    rows = [row[:3] for row in result.tables[0].rows]
    assert len(rows) == len(set(rows)) == 2 * 2 + 2 * 2
    timed = [row for row in result.tables[0].rows if row[-1] != "–"]
    assert {row[1] for row in timed} == {TINY.compared_depth}


def test_networks_that_learnt_next_to_nothing_are_not_praised(result):
    assert result.lead.startswith("No decoupled network tried here")
    forces = [c for c in result.comparisons if c.what.endswith("force error")]
    assert [c.agreement for c in forces] == ["no", "no"]


def test_the_papers_figures_close_the_table_of_its_amount_of_data(result):
    assert result.tables[1].rows[-1][0] == "the paper"
    assert len(result.tables[1].rows) == 3


def test_the_quick_plan_is_a_small_part_of_the_full_one():
    assert set(QUICK.depths) < set(FULL.depths)
    assert set(QUICK.widths) < set(FULL.widths)
    assert QUICK.samples * QUICK.epochs < 0.1 * FULL.samples * FULL.epochs
    assert FULL.compared_depth in FULL.depths
    assert QUICK.compared_depth in QUICK.depths
