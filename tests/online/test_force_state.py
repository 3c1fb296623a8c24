"""What each wrench stands for, and between which bounds the force lies."""

import math

import numpy as np
import pytest
from sample_feed import PUSHED, UNLOADED, AnyDifference, Feed

from cablesense_msgs_py.messages import NO_CONTACT, ForceState, read_force_state
from cablesense_msgs_py.topics import ContractError
from cablesense_online.models import load_model

diagnostic_msgs = pytest.importorskip("diagnostic_msgs.msg")
pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark


def test_an_arm_is_untared_then_free_then_touched():
    assert Feed().sample().force is ForceState.UNTARED
    feed = Feed().tared()
    assert feed.sample().force is ForceState.FREE
    assert feed.sample(PUSHED).force is ForceState.CONTACT


def test_an_arm_that_moves_has_no_estimate():
    feed = Feed().tared()
    feed.command(np.full(8, 0.02))
    answer = feed.sample(PUSHED)
    assert answer.force is ForceState.MOVING
    assert answer.bounds is None


def test_what_cannot_be_used_is_stale_or_refused():
    feed = Feed().tared()
    assert feed.sample(PUSHED, age_ns=300_000_000).force is ForceState.STALE
    assert feed.sample([math.nan, *PUSHED[1:]]).force is ForceState.REFUSED
    assert feed.sample(raw=b"no message").force is ForceState.REFUSED


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
