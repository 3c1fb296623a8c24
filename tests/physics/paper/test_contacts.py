"""Fig. 10 to 14: one contact and several, every bundled model beside the noise bound."""

import numpy as np
import pytest

from cablesense_training.evaluation.comparison import SHIPPED
from paper.boosting import BoostingSettings
from paper.studies.several_contacts import several_contacts
from paper.studies.single_contact import (
    ALL_SETTINGS,
    FORCE_EDGES_N,
    TREES,
    answered_setting,
    single_contact,
)
from paper.study import PAPER, Agreement
from tests.helpers.paper_studies import compared, result_of

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def straight():
    return answered_setting(ALL_SETTINGS[0], 512, 512, BoostingSettings(rounds=10, leaves=15))


def test_errors_by_force_average_to_the_error_over_all(straight):
    count, _ = np.histogram(straight.truth.magnitude_n[straight.truth.segment > 0], FORCE_EDGES_N)
    for name, tested in straight.tested.items():
        mean_n = np.average(straight.error_by_force_n(name), weights=count)
        assert mean_n == pytest.approx(tested.metrics.errors.magnitude_mae_n, rel=1e-9)


def test_the_shipped_estimator_comes_near_the_bound_and_trees_do_not(straight):
    bound_n = straight.bound.magnitude_mae_n
    assert straight.tested[SHIPPED].metrics.errors.magnitude_mae_n < 1.3 * bound_n
    assert straight.tested[TREES].metrics.errors.magnitude_mae_n > 10.0 * bound_n
    assert sum(part.contacts for part in straight.bound_by_force) == straight.bound.contacts


@pytest.fixture(scope="module")
def result():
    chosen = [s for s in ALL_SETTINGS if s.name in ("straight", "random_pose")]
    small = {"samples": 256, "training_samples": 256, "rounds": 3, "trees_everywhere": False}
    return result_of(
        "single_contact", lambda size, progress: single_contact(size, progress, chosen), small
    )


def test_the_two_stage_network_meets_all_the_papers_errors(result):
    comparisons = compared(result)
    for what in (
        "contacts on the right segment",
        "direction error, mean absolute",
        "magnitude error, mean absolute",
        "magnitude error, RMS",
    ):
        assert comparisons[f"two-stage network: {what}", PAPER][2] is Agreement.YES, what


@pytest.fixture(scope="module")
def several():
    small = {"samples": 1024, "training_samples": 512, "rounds": 5}
    return result_of("several_contacts", several_contacts, small)


def test_over_99_percent_are_recognised_and_errors_fall_towards_the_tip(several):
    comparisons = compared(several)
    recognised = comparisons["two-stage network: segments recognised, contacts from 5 N", PAPER]
    assert recognised[0] > 99.0
    falling = comparisons["two-stage network: force error from point 1 to 4", PAPER]
    assert falling[2] is Agreement.YES


def test_no_estimator_is_below_the_noise_bound_by_more_than_chance(several):
    rows = {row[0]: row[4:] for row in several.tables[0].rows}
    for estimator in ("two-stage (the paper’s)", "gradient boosting"):
        for error_n, bound_n in zip(rows[estimator], rows["noise bound"], strict=True):
            assert error_n > 0.85 * bound_n
    assert rows["the paper"] == ("–",) * 4
