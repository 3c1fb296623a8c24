"""Fig. 10 to 12, on few samples: what the paper's network reaches there, ours does too."""

import pytest
from paper_studies import figures, quick_result

from cablesense_paper import contact_tests
from cablesense_paper.studies import single_contact
from cablesense_paper.study import PAPER, Agreement

pytestmark = pytest.mark.slow  # answers samples with every model, grows trees and draws


@pytest.fixture(scope="module")
def result():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(single_contact, "QUICK_SAMPLES", 512)
        patch.setattr(single_contact, "QUICK_TRAINING_SAMPLES", 512)
        patch.setattr(single_contact, "QUICK_ROUNDS", 10)
        chosen = contact_tests.all_settings()[:2]
        patch.setattr(contact_tests, "all_settings", lambda: chosen)
        return quick_result("single_contact")


def test_the_two_stage_network_meets_all_the_papers_figures_of_merit(result):
    found = figures(result)
    for what in (
        "contacts on the right segment",
        "direction error, mean absolute",
        "magnitude error, mean absolute",
        "magnitude error, RMS",
    ):
        assert found[f"two-stage network: {what}", PAPER][2] is Agreement.YES, what


def test_every_table_ends_with_what_it_is_measured_against(result):
    like_paper, *settings = result.tables
    assert like_paper.rows[-1] == ("the paper", "over 98", 5.96, 9.97, 14.26)
    assert [table.rows[-1][0] for table in settings] == ["noise bound"] * 2


def test_all_four_estimators_are_in_the_first_setting(result):
    assert len(result.tables[1].rows) == 5
    assert len(result.pictures) == 5
