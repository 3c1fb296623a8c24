"""The decision on a contact, the meaning of each wrench, and the bounds of the force."""

import math

import numpy as np
import pytest
from sample_feed import PUSHED, UNLOADED, AnyDifference, Feed

from cablesense_msgs_py.messages import NO_CONTACT, Contact, ForceState, read_force_state
from cablesense_msgs_py.topics import ContractError
from cablesense_online.answer import decide
from cablesense_online.models import load_model
from cablesense_online.samples import ProblemKind, SampleError

diagnostic_msgs = pytest.importorskip("diagnostic_msgs.msg")
pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark


def test_an_arm_is_untared_then_free_then_touched():
    assert Feed().sample().force is ForceState.UNTARED
    feed = Feed().tared()
    assert feed.sample().force is ForceState.FREE
    assert feed.sample(PUSHED).force is ForceState.CONTACT


def test_readings_that_fit_no_contact_are_implausible():
    feed = Feed(load_model("cdsm", "").estimator, largest_misfit=2.3).tared()
    faulty = UNLOADED.copy()
    faulty[5] += 30.0
    assert feed.sample(faulty).force is ForceState.IMPLAUSIBLE


def test_the_bounds_hold_magnitude_and_direction_of_the_estimate():
    feed = Feed().tared()
    answer = feed.sample(PUSHED)
    contact, (lower, upper) = answer.contact, answer.bounds
    assert lower.segment == upper.segment == contact.segment == 3
    assert lower.magnitude_n < contact.magnitude_n < upper.magnitude_n
    assert upper.magnitude_n - lower.magnitude_n == pytest.approx(4 * 0.1, rel=0.03)
    assert upper.angle_deg - lower.angle_deg == pytest.approx(4 * 5.0, rel=0.03)


def test_a_force_that_may_act_unseen_makes_the_state_hidden():
    unsure = Feed(AnyDifference(std_n=3.0)).tared()
    answer = unsure.sample()
    assert (answer.contact, answer.force) == (NO_CONTACT, ForceState.HIDDEN)
    lower, upper = answer.bounds
    assert (lower, round(upper.magnitude_n)) == (NO_CONTACT, 6)
    tolerant = Feed(AnyDifference(std_n=3.0), hidden_above_n=7.0).tared()
    assert tolerant.sample().force is ForceState.FREE


def test_a_parameter_decides_what_an_unknown_force_is_published_as():
    feed = Feed().tared()
    known = [feed.sample(), feed.sample(PUSHED)]
    unknown = feed.sample([math.nan, *PUSHED[1:]])
    for answer in known:
        assert answer.wrench("nan") == answer.wrench("none") == answer.contact.wrench
    assert unknown.wrench("zero") == NO_CONTACT.wrench
    assert np.isnan(unknown.wrench("nan")).all()
    assert unknown.wrench("none") is None


@pytest.mark.parametrize("texts", [[], ["freed"], ["free", "free"]])
def test_a_status_that_is_no_state_is_refused(texts):
    statuses = [diagnostic_msgs.DiagnosticStatus(message=text) for text in texts]
    with pytest.raises(ContractError, match="must be one of free, contact"):
        read_force_state(diagnostic_msgs.DiagnosticArray(status=statuses))


CONTACT_M = (0.05, 0.06, 0.07, 0.08)


def decided(probabilities, angle_deg=0.0, magnitude_n=5.0, threshold=0.5):
    return decide(probabilities, angle_deg, magnitude_n, threshold, CONTACT_M)


def test_the_likeliest_segment_is_touched_where_any_contact_reaches_the_threshold():
    assert decided([0.1, 0.2, 0.1, 0.55, 0.05], 70.0, 40.0) == Contact(3, 70.0, 40.0, 0.07)
    assert decided([0.4, 0.15, 0.15, 0.1, 0.2]).segment == 4
    assert decided([0.25, 0.75, 0.0, 0.0, 0.0], threshold=0.75).segment == 1
    assert decided([0.25, 0.75, 0.0, 0.0, 0.0], threshold=0.8) == NO_CONTACT


@pytest.mark.parametrize("magnitude_n", [0.0, -3.0])
def test_a_force_that_does_not_push_is_no_contact(magnitude_n):
    assert decided([0.0, 1.0, 0.0, 0.0, 0.0], 10.0, magnitude_n) == NO_CONTACT


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(3))
def test_a_number_that_is_not_finite_is_refused_also_where_nothing_touches(value, place):
    estimate = [[1.0, 0.0, 0.0, 0.0, 0.0], 10.0, 0.0]
    estimate[place] = [1.0, value, 0.0, 0.0, 0.0] if place == 0 else value
    with pytest.raises(SampleError) as caught:
        decided(*estimate)
    assert caught.value.kind is ProblemKind.ESTIMATE
