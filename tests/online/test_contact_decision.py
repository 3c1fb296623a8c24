"""What a model says is a contact where it is likely, pushes and is a number."""

import math

import pytest

from cablesense_msgs_py.wrenches import NO_CONTACT, Contact
from cablesense_online.answers import ContactDecision
from cablesense_online.samples import ProblemKind, SampleError

CONTACT_M = (0.05, 0.06, 0.07, 0.08)


def decision(threshold=0.5):
    return ContactDecision(CONTACT_M, threshold)


def test_the_likeliest_segment_is_touched_at_its_contact_point():
    said = decision().decide([0.1, 0.2, 0.1, 0.55, 0.05], 70.0, 40.0)
    assert said == Contact(3, 70.0, 40.0, 0.07)


def test_a_contact_anywhere_counts_even_where_none_is_the_likeliest_single_answer():
    assert decision().decide([0.4, 0.15, 0.15, 0.1, 0.2], 0.0, 5.0).segment == 4


def test_the_threshold_counts_as_reached_and_may_change():
    decide = decision(0.75)
    probabilities = [0.25, 0.75, 0.0, 0.0, 0.0]
    assert decide.decide(probabilities, 0.0, 5.0).segment == 1
    decide.threshold = 0.8
    assert decide.decide(probabilities, 0.0, 5.0) == NO_CONTACT


@pytest.mark.parametrize("magnitude_n", [0.0, -3.0])
def test_a_force_that_does_not_push_is_no_contact(magnitude_n):
    assert decision().decide([0.0, 1.0, 0.0, 0.0, 0.0], 10.0, magnitude_n) == NO_CONTACT


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(3))
def test_a_number_that_is_not_finite_is_refused_also_where_nothing_touches(value, place):
    said = [[1.0, 0.0, 0.0, 0.0, 0.0], 10.0, 0.0]
    said[place] = [1.0, value, 0.0, 0.0, 0.0] if place == 0 else value
    with pytest.raises(SampleError) as caught:
        decision().decide(*said)
    assert caught.value.kind is ProblemKind.ESTIMATE
