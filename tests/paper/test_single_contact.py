"""Fig. 10 to 12: every bundled single-contact model on the same samples as the noise bound."""

import numpy as np
import pytest
from paper_studies import compared, result_of

from cablesense_training.evaluation.comparison import SHIPPED
from cablesense_training.inference.metadata import find_model
from cablesense_training.inference.session import read_model
from examples.paper.boosting import BoostingSettings
from examples.paper.studies.single_contact import (
    ALL_SETTINGS,
    FORCE_EDGES_N,
    LABELS,
    TREES,
    answered_setting,
    single_contact,
)
from examples.paper.study import PAPER, Agreement

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def straight():
    return answered_setting(ALL_SETTINGS[0], 512, 512, BoostingSettings(rounds=10, leaves=15))


def _from_single_samples(name):
    """Neither for several contacts nor for an arm with history or in motion."""
    _, metadata = read_model(find_model(name))
    alone = metadata.kind == "single-contact" and not metadata.memory
    return alone and not metadata.arm.effects


def test_all_estimators_answer_the_same_samples(straight):
    assert set(straight.tested) == set(LABELS)
    for tested in straight.tested.values():
        assert tested.metrics.samples == len(straight.truth.segment) == 512
        assert np.sum(tested.metrics.confusion) == 512


def test_errors_by_force_average_to_the_error_over_all(straight):
    count, _ = np.histogram(straight.truth.magnitude_n[straight.truth.segment > 0], FORCE_EDGES_N)
    for name, tested in straight.tested.items():
        mean_n = np.average(straight.error_by_force_n(name), weights=count)
        assert mean_n == pytest.approx(tested.metrics.errors.magnitude_mae_n, rel=1e-9)


def test_the_shipped_model_comes_near_the_bound_and_trees_do_not(straight):
    bound_n = straight.bound.magnitude_mae_n
    assert straight.tested[SHIPPED].metrics.errors.magnitude_mae_n < 1.3 * bound_n
    assert straight.tested[TREES].metrics.errors.magnitude_mae_n > 10.0 * bound_n
    assert sum(part.contacts for part in straight.bound_by_force) == straight.bound.contacts


@pytest.fixture(scope="module")
def result():
    chosen = [s for s in ALL_SETTINGS if s.name in ("straight", "tensions_only")]
    small = {"samples": 256, "training_samples": 256, "rounds": 3, "trees_everywhere": False}
    return result_of(
        "single_contact", lambda size, progress: single_contact(size, progress, chosen), small
    )


def test_the_two_stage_network_meets_all_the_papers_errors(result):
    found = compared(result)
    for what in (
        "contacts on the right segment",
        "direction error, mean absolute",
        "magnitude error, mean absolute",
        "magnitude error, RMS",
    ):
        assert found[f"two-stage network: {what}", PAPER][2] is Agreement.YES, what
