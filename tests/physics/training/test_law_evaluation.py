"""Statements of the law against the truth: built arms, bounds, coverage, and what is wrong."""

import numpy as np
import pytest

from cablesense_contact.judgement import ContactState
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.built_arm import as_described, built_arm
from cablesense_sim.touch import touched_places
from cablesense_training.evaluation.law import (
    Statements,
    TrueContacts,
    bound_std,
    evaluate_built,
    evaluate_exact,
    law_protocol,
    stated_contacts,
    true_contacts,
)
from cablesense_training.evaluation.touches import (
    COMMISSIONED_POSES,
    drawn_touches,
    tensions_along_n,
    touched_readings_n,
    unloaded_readings,
)
from cablesense_training.law.build import TorchLaw

LAB = open_arm("cdsm_lab")
LENGTH_M = mechanism_of(LAB).segment_length_m


@pytest.fixture(scope="module")
def touches():
    return drawn_touches(LAB, law_protocol(LAB, 400), seed=3)


def _stated(**changes):
    """One answer of a contact of 20 N in the middle of segment 2."""
    middle = LENGTH_M[0] + 0.5 * LENGTH_M[1]
    stated = {
        "state": np.array([ContactState.CONTACT], dtype=object),
        "segment": np.array([2]),
        "place_m": np.array([0.5 * LENGTH_M[1]]),
        "region_m": middle + np.array([[-0.002, 0.002]]),
        "force_n": np.array([[1.0, 0.0, 20.0]]),
        "magnitude_ci95_n": np.array([[19.5, 20.5]]),
        "moment_n_m": np.array([[-20.0 * 0.5 * LENGTH_M[1], 0.0]]),
    }
    return Statements(**stated | changes)


def _truth(segment=2, place_m=0.5 * LENGTH_M[1], force_n=(1.0, 0.0, 20.0)):
    place = np.array([place_m])
    return TrueContacts(np.array([segment]), place, place, np.array([force_n]))


def test_a_perfect_statement_has_no_error_and_holds():
    statements = stated_contacts(LAB, _truth(), _stated())
    assert statements.answered == statements.force_known == statements.same_place == 1.0
    assert statements.place_coverage95 == statements.force_coverage95 == 1.0
    assert statements.place_mm.rms == pytest.approx(0.0, abs=1e-9)
    assert statements.lateral_n.rms == statements.axial_n.rms == 0.0
    assert statements.moment_n_m.rms == pytest.approx(0.0, abs=1e-9)
    assert statements.wrong == 0


@pytest.mark.parametrize(
    ("truth", "wrong"),
    [
        ({"segment": 4}, 1),
        ({"force_n": (0.0, 0.0, 30.0)}, 1),
        ({"force_n": (0.0, 0.0, 24.0)}, 0),
        ({"place_m": 0.6 * LENGTH_M[1]}, 0),
    ],
)
def test_what_is_wrong_is_far_off_in_place_or_force(truth, wrong):
    assert stated_contacts(LAB, _truth(**truth), _stated()).wrong == wrong


def test_the_end_of_a_segment_and_the_beginning_of_the_next_are_one_place():
    end = stated_contacts(
        LAB, _truth(segment=1, place_m=LENGTH_M[0]), _stated(place_m=np.array([0.001]))
    )
    assert end.same_place == 1.0
    assert end.place_mm.median == pytest.approx(1.0)
    assert end.wrong == 0


def test_what_is_not_vouched_for_has_no_error():
    unconfirmed = np.array([ContactState.UNCONFIRMED], dtype=object)
    statements = stated_contacts(LAB, _truth(segment=4), _stated(state=unconfirmed))
    assert statements.answered == 0.0
    assert statements.wrong == 0
    assert np.isnan(statements.place_mm.median)


def test_a_force_at_a_radius_acts_as_on_its_line_of_action(touches):
    """The moment of an axial force at the surface moves the line by at most radius times ratio."""
    places = touched_places(LAB)
    touched = touches.contacts
    lateral_n = np.hypot(touches.force_n[..., 1], touches.force_n[..., 2])
    moved_m = touches.line_m - touches.place_m
    most_m = places.radius_m * np.abs(touches.force_n[..., 0]) / np.maximum(lateral_n, 1e-9)
    assert (np.abs(moved_m) <= most_m + 1e-12)[touched].all()
    assert (moved_m * touches.force_n[..., 0] >= 0.0).all()
    assert np.abs(moved_m[touched]).max() > 0.005
    assert not moved_m[~touched].any()


def test_an_arm_as_its_file_reads_what_statics_say(touches):
    few = touches.select(slice(0, 20))
    rng = np.random.default_rng(0)
    readings = touched_readings_n(LAB, as_described(LAB), few, rng)
    assert readings.shape == (2, 20, 12)
    free = ~few.contacts.any(axis=1)
    apart_n = np.abs(readings[1] - readings[0]).max(axis=1)
    assert apart_n[free].max() < 1.0 < apart_n[~free].min()


def test_friction_that_the_file_lists_is_walked_through():
    arm = open_arm("cdsm_friction")
    few = drawn_touches(arm, law_protocol(arm, 8), seed=1)
    readings = touched_readings_n(arm, as_described(arm), few, np.random.default_rng(0))
    assert readings.shape[0] > 2
    assert np.isfinite(readings).all()


def test_a_built_arm_is_read_in_all_its_unloaded_poses():
    rng = np.random.default_rng(5)
    unloaded = unloaded_readings(LAB, built_arm(LAB, 4), 0.17, rng)
    assert len(unloaded) == COMMISSIONED_POSES
    assert not unloaded[0].command_rad.any()
    straight = np.zeros((1, 1, 8))
    nothing = np.zeros((1, 1, 4, 3))
    expected_n = tensions_along_n(LAB, as_described(LAB), np.zeros(1), straight, nothing)[0, 0]
    off_n = np.abs(unloaded[0].reading_n - expected_n)
    assert 0.2 < off_n.max() < 30.0


def test_the_bound_grows_with_noise_and_falls_with_force(touches):
    single = touches.select(touches.contacts.sum(axis=1) == 1)
    mechanism = as_described(LAB).mechanism
    bound = bound_std(LAB, mechanism, single)
    assert bound.shape == (len(single.contacts), 4)
    assert (bound > 0.0).all()
    noisy = LAB.model_copy(update={"sensors": LAB.sensors.model_copy(update={"noise_std_n": 0.5})})
    assert (bound_std(noisy, mechanism, single)[:, 1] >= (1.0 - 1e-6) * bound[:, 1]).all()
    outer = true_contacts(single).segment == 4
    more = bound_std(noisy, mechanism, single)[outer, 1] / bound[outer, 1]
    assert np.median(more) > 3.0
    truth = true_contacts(single)
    weak = np.hypot(truth.force_n[:, 1], truth.force_n[:, 2]) < 15.0
    assert np.median(bound[outer & weak, 0]) > np.median(bound[outer & ~weak, 0])


@pytest.mark.slow
def test_arms_of_the_tolerances_are_answered_and_intervals_hold():
    law = TorchLaw(LAB)
    protocol = law_protocol(LAB, 1200)
    built = evaluate_built(law, LAB, protocol, seed=1)
    exact = evaluate_exact(law, LAB, protocol, seed=1)
    assert built.arms == 12
    assert built.doubted_calibrations == 0
    for found in (built, exact):
        assert found.free > 0.98
        assert found.false_contacts == 0
        assert found.two_as_one < 0.3
        assert found.touched.answered > 0.95
        assert found.touched.same_place > 0.98
        assert found.touched.place_coverage95 > 0.9
        assert found.touched.force_coverage95 > 0.9
        assert found.touched.wrong <= 0.02 * found.touched.contacts
    assert exact.touched.place_mm.median_over_bound < 1.5
    assert exact.touched.lateral_n.median_over_bound < 1.8
    assert exact.touched.lateral_n.median < built.touched.lateral_n.median
    content = built.as_json()
    assert content["place_mm"]["segment_1"]["median"] is None
