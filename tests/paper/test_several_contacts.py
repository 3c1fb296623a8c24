"""Fig. 13 and 14, on few samples: points recognised, errors that fall towards the tip."""

import pytest
from paper_studies import compared, result_of

from examples.paper.studies.several_contacts import several_contacts
from examples.paper.study import PAPER, Agreement

pytestmark = pytest.mark.slow  # answers samples, grows trees and draws


@pytest.fixture(scope="module")
def result():
    small = {"samples": 1024, "training_samples": 512, "rounds": 5}
    return result_of("several_contacts", several_contacts, small)


def test_over_99_percent_are_recognised_and_errors_fall_towards_the_tip(result):
    found = compared(result)
    recognised = found["two-stage network: segments recognised, contacts from 5 N", PAPER]
    assert recognised[0] > 99.0
    falling = found["two-stage network: force error from point 1 to 4", PAPER]
    assert falling[2] is Agreement.YES


def test_no_estimator_is_below_the_noise_bound_by_more_than_chance(result):
    rows = {row[0]: row[4:] for row in result.tables[0].rows}
    for estimator in ("shipped model", "two-stage (the paper’s)", "gradient boosting"):
        for error_n, bound_n in zip(rows[estimator], rows["noise bound"], strict=True):
            assert error_n > 0.85 * bound_n
    assert rows["the paper"] == ("–",) * 4
