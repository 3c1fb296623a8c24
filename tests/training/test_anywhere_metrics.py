"""Errors of contacts anywhere: their bound is the tensions' own, and baselines stay behind it."""

import numpy as np
import pytest

from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.contact_location import locate, torque_balance, touched_at
from cablesense_sim.replay import difference_variance_n2
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import AnywhereContact
from cablesense_training.evaluation.anywhere import (
    LocatedContacts,
    anywhere_metrics,
    bound_covariance,
    commanded_profile,
    four_points,
    touched,
)
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model

ARM = open_arm("cdsm")
VARIANCE_N2 = difference_variance_n2(ARM.sensors, 50)


@pytest.fixture(scope="module")
def dataset():
    protocol = AnywhereContact(samples=2000, pose="random", force_low_n=5.0)
    return draw_dataset(ARM, protocol, seed=8)


def test_errors_drawn_from_the_bound_are_as_large_as_the_bound(dataset):
    rng = np.random.default_rng(0)
    single = dataset.contacts.sum(axis=1) == 1
    segments, places_m, forces_n = (part[:, 0] for part in touched(dataset.select(single), 1))
    count = len(dataset)
    answer = LocatedContacts(
        np.zeros(count, dtype=np.int64), np.zeros(count), np.zeros((count, 3)), np.zeros(count)
    )
    root = np.linalg.cholesky(bound_covariance(dataset.select(single), 1))
    off = (root @ rng.normal(size=(len(segments), 4, 1)))[..., 0]
    answer.segment[single] = segments
    answer.place_m[single] = places_m + off[:, 3]
    answer.force_n[single] = forces_n + off[:, :3]
    answer.moment_n_m[single] = answer.place_m[single] * np.linalg.norm(
        answer.force_n[single, 1:], axis=1
    )
    for errors in anywhere_metrics(dataset, answer).segments[1:]:
        # not the moment: force and place are drawn far apart, and err together
        for each in (errors.place_mm, errors.normal_n, errors.axial_n):
            assert each.rms_over_bound == pytest.approx(1.0, abs=0.15)
            assert each.median_over_bound == pytest.approx(1.0, abs=0.2)
        assert errors.segment_right == 1.0
        assert np.isnan(errors.place_coverage95)


def test_an_answer_of_another_segment_or_of_no_contact_is_counted(dataset):
    count = len(dataset)
    every = LocatedContacts(
        np.full(count, 2), np.full(count, 0.05), np.ones((count, 3)), np.ones(count)
    )
    metrics = anywhere_metrics(dataset, every)
    assert metrics.false_contacts == metrics.untouched == (~dataset.contacts.any(axis=1)).sum()
    assert [errors.segment_right for errors in metrics.segments] == [0.0, 1.0, 0.0, 0.0]


def test_on_a_stiff_arm_the_textbook_profile_finds_places_and_four_points_do_not(dataset):
    balance = torque_balance(
        mechanism_of(ARM), dataset.command_rad, dataset.tension_difference_n, VARIANCE_N2
    )
    posterior = LocatedContacts.of(locate(balance, touched_at(ARM)[0]))
    estimator = Estimator.load(find_model("peers/cdsm_closed_form"), ARM)
    answers = (posterior, commanded_profile(dataset), four_points(estimator, dataset))
    best, profile, points = (anywhere_metrics(dataset, answer).segments[2] for answer in answers)
    assert best.place_mm.rms_over_bound < 1.15
    assert best.place_mm.median < profile.place_mm.median < 5.0 < points.place_mm.median
