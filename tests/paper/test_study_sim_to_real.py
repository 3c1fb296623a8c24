"""The study of sim-to-real says what the diagnosis found."""

import pytest
from paper_studies import figures, quick_result
from table2_diagnosis import diagnosed

from cablesense_paper.study import PAPER, Agreement

pytestmark = pytest.mark.slow  # the diagnosis behind it


@pytest.fixture(scope="module")
def result():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "cablesense_paper.table_2_gap.diagnose_table",
            lambda tables, command, tell, workers: {None: diagnosed()}[tables],
        )
        return quick_result("sim_to_real")


def test_the_verdict_is_told_with_its_probability_and_leads(result):
    assert result.lead.startswith("Verdict: unknown (")
    assert any("What to measure next" in note for note in result.notes)
    assert any("slack" in note for note in result.notes)


def test_the_gap_is_smaller_than_the_papers(result):
    ours, theirs, agreement = figures(result)["sim-to-real gap, largest", PAPER]
    assert ours < theirs == 5.98
    assert agreement is Agreement.YES


def test_the_table_says_what_each_effect_leaves(result):
    table = result.tables[0]
    left = [row[3] for row in table.rows]
    assert left == sorted(left)
    assert max(left) <= 1.05 * diagnosed().verdict.gap.before_n
