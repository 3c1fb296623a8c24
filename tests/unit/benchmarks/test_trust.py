"""What answers to touched arms come to: wrong ones, those next to a joint, two as one."""

import numpy as np
import pytest
from judging import Acting
from trust import Answered, Touch, figures

from cablesense_contact.estimate import ContactPlace, Estimate
from cablesense_msgs_py.messages import Contact, ForceState
from cablesense_online.answer import Answer
from cablesense_plants.arm.built import Push

LENGTH_M = np.full(4, 0.13)
STRAIGHT = np.tile(np.eye(3), (4, 1, 1))


def touch(segment, place_m, y_n, z_n):
    return Touch(segment, place_m, np.array([0.0, y_n, z_n]))


def answered(touches, state, *contacts, high_n=50.0):
    """An answer with an estimate whose interval of the place is the stated one alone."""
    pushes = tuple(Push(*each) for each in touches)
    place_m = contacts[0].contact_m if contacts else 0.06
    place = ContactPlace(place_m, place_m, place_m, 0.0, np.eye(4), 0.0, force_known=True)
    estimate = Estimate(
        probabilities=np.array([0.0, 1.0, 0.0, 0.0, 0.0]),
        segment=contacts[0].segment if contacts else 0,
        angle_deg=0.0,
        magnitude_n=0.0,
        magnitude_std_n=1.0,
        angle_std_deg=1.0,
        low_n=0.0,
        high_n=high_n,
        place=place,
    )
    answer = Answer(state, contacts, estimate, contact_m=[0.065] * 4)
    return Answered(touches, Acting(pushes, STRAIGHT, LENGTH_M), answer, "")


def test_the_moment_of_a_contact_behind_joint_2_is_right_on_segment_1():
    touches = [touch(2, 0.0025, 0.0, 17.0)]
    moment_n_m = 17.0 * 0.1325
    stated = Contact(1, 0.0, 0.0, 0.047, moment_n_m=moment_n_m)
    right_counts = figures([answered(touches, ForceState.MOMENT, stated)])
    assert right_counts["vouched"] == 1
    assert right_counts["wrong_and_vouched"] == 0
    twice = stated._replace(moment_n_m=2.0 * moment_n_m)
    wrong_counts = figures([answered(touches, ForceState.MOMENT, twice)])
    assert wrong_counts["wrong_and_vouched_of"]["one contact"] == 1
    assert wrong_counts["wrong"][0]["off_n"] == pytest.approx(17.33, abs=0.01)


def test_a_free_arm_is_judged_by_moments_and_forces_next_to_a_joint_are_counted():
    near = answered([touch(1, 0.004, 0.0, 17.0)], ForceState.FREE)
    beyond = answered([touch(1, 0.004, 0.0, 60.0)], ForceState.FREE)
    far = answered([touch(1, 0.1, 0.0, 17.0)], ForceState.FREE)
    small = answered([touch(4, 0.1, 0.0, 1.0)], ForceState.FREE)
    counts = figures([near, beyond, far, small])
    next_to_joint = counts["free_under_more_than_5_n_next_to_a_joint"]
    assert next_to_joint == {"contacts": 2, "above_the_stated_bound": 1}
    assert counts["wrong_and_vouched"] == 1
    assert counts["wrong"][0]["touches"] == [(1, 0.1, [0.0, 0.0, 17.0])]


def test_two_contacts_that_are_answered_as_one_have_a_figure_of_their_own():
    touches = [touch(1, 0.1, 0.0, 20.0), touch(2, 0.06, 0.0, 20.0)]
    one_of_them = answered(touches, ForceState.CONTACT, Contact(2, 0.0, 21.0, 0.062))
    neither = answered(touches, ForceState.CONTACT, Contact(2, 0.0, 35.0, 0.03))
    unconfirmed = answered(touches, ForceState.UNCONFIRMED, Contact(2, 0.0, 35.0, 0.03))
    counts = figures([one_of_them, neither, unconfirmed])
    assert counts["two_answered_as_one"] == {
        "contacts": 2,
        "wrong": 1,
        "share_wrong": 0.5,
        "right_about_one_and_the_other_above_5_n": 1,
    }
    assert counts["wrong_and_vouched_of"] == {"untouched": 0, "one contact": 0, "two contacts": 1}
    assert counts["wrong_and_unconfirmed"] == 1


def test_a_contact_on_an_untouched_arm_is_wrong_above_5_n():
    small = answered([], ForceState.CONTACT, Contact(3, 0.0, 4.0, 0.06))
    large = answered([], ForceState.CONTACT, Contact(3, 0.0, 9.0, 0.06))
    counts = figures([small, large, answered([], ForceState.FREE)])
    assert counts["vouched"] == 2
    assert counts["wrong_and_vouched_of"]["untouched"] == 1
    assert counts["wrong_and_vouched_by_more_than_5_n"] == 1
