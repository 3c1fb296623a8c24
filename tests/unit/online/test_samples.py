"""Impossible stamps and readings are refused; missing samples are counted and reported."""

import math
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_msgs_py.messages import Level
from cablesense_online.samples import (
    FollowedPublisher,
    InputHealth,
    ProblemKind,
    SampleCheck,
    SampleClock,
    SampleError,
)

MS = 1_000_000
NOW = 1_700_000_000_000 * MS

LOST = "{} samples lost on the way, as on a busy machine; the others are used"


@pytest.mark.parametrize(
    ("before", "stamp", "complaint"),
    [
        (None, NOW - 201 * MS, "0.201 s old"),
        (None, NOW + 201 * MS, "ahead of this machine's clock"),
        (NOW, NOW, "must ascend"),
        (NOW, NOW - 150 * MS, "must ascend"),
        (NOW, 0, r"header.stamp is 0"),
    ],
)
def test_a_stamp_that_is_not_of_a_present_sample_is_refused(before, stamp, complaint):
    clock = SampleClock(0.2)
    clock.accept(0, NOW)  # without a stamp: counts as new, until one has come
    assert clock.largest_age_s == 0.0
    if before:
        clock.accept(before, NOW + 5 * MS)
        assert clock.largest_age_s == pytest.approx(0.005)
    with pytest.raises(SampleError, match=complaint) as caught:
        clock.accept(stamp, NOW)
    assert caught.value.kind is ProblemKind.CLOCK


def test_stamps_step_back_where_the_clock_does():
    clock = SampleClock(0.2)
    clock.accept(NOW, NOW)
    clock.accept(NOW - 3600_000 * MS, NOW - 3600_000 * MS + MS)
    clock.accept(NOW - 3599_990 * MS, NOW - 3599_990 * MS)


GOOD = [50.0] * 12


def changed(cable, tension):
    return [*GOOD[: cable - 1], tension, *GOOD[cable:]]


@pytest.mark.parametrize(
    ("range_n", "tension", "kind"),
    [
        *((None, value, ProblemKind.NOT_FINITE) for value in (math.nan, math.inf, -math.inf)),
        *((None, value, ProblemKind.IMPLAUSIBLE) for value in (-21.0, 1e5, 1e308)),
        *(((0.0, 500.0), value, ProblemKind.SATURATED) for value in (0.0, 500.0, 501.0, -1.0)),
    ],
)
@pytest.mark.parametrize("cable", [1, 12])
def test_readings_that_no_cable_carries_are_refused_by_cable(cable, range_n, tension, kind):
    with pytest.raises(SampleError, match=f"cable_{cable} ") as caught:
        SampleCheck(range_n, 1.0).check(changed(cable, tension))
    assert caught.value.kind is kind


def status(health, now_s, missing=0, publishers=1):
    return health.status(now_s, lost=missing, publisher_count=publishers)


def fed(clock=None, publisher=None):
    publisher = publisher or FollowedPublisher()
    health = InputHealth(clock or SampleClock(0.2), publisher, 0.0)
    for k in range(100):
        health.arrived(0.01 * (k + 1))
    return health


def test_rate_age_losses_and_silence_are_reported():
    clock = SampleClock(0.2)
    health = fed(clock)
    clock.accept(10**18, 10**18 + 4_000_000)
    report = status(health, 1.0)
    assert report.level is Level.OK
    assert report.values["rate (Hz)"] == "100.0"
    assert report.values["largest age (s)"] == "0.0040"
    assert status(fed(), 1.0, missing=3).message == LOST.format(3)
    nothing = InputHealth(SampleClock(0.2), FollowedPublisher(), 0.0)
    assert status(nothing, 1.0).message == "no sample received yet"
    report = status(fed(), 3.0)
    assert (report.level, report.message) == (Level.STALE, "no sample for 2.0 s")


def test_refused_samples_are_an_error_until_the_next_report():
    health = fed()
    health.refused(SampleError(ProblemKind.NOT_FINITE, "effort of cable_3 is nan N"))
    report = status(health, 1.0)
    assert report.level is Level.ERROR
    assert "1 not finite" in report.message
    assert "cable_3" in report.values["last refusal"]
    health.arrived(1.05)
    again = status(health, 1.1)
    assert again.level is Level.OK
    assert again.values["refused in all"] == "1"


def test_a_silent_second_publisher_is_a_warning_and_one_that_publishes_an_error():
    health = fed()
    assert status(health, 1.0, publishers=2).level is Level.WARN
    health.refused(SampleError(ProblemKind.PUBLISHER, "its publisher's number 3"))
    assert status(health, 1.1, publishers=2).level is Level.ERROR


def heard(samples, publishers=2, period_s=0.01):
    """Accepted samples (publisher, number), and those with which another was followed."""
    watched = FollowedPublisher(0.2)
    watched.matched(publishers)
    accepted = []
    changes = []
    for at, sample in enumerate(samples):
        with suppress(SampleError):
            if watched.accept(sample[1], period_s * at):
                changes.append(sample)
            accepted.append(sample)
    return accepted, changes


def numbered(first, count, name="a"):
    return [(name, number) for number in range(first, first + count)]


def in_turn(*sources):
    return [sample for samples in zip(*sources, strict=True) for sample in samples]


@pytest.mark.parametrize("lead", [0, 1])
def test_two_publishers_with_the_same_numbers_are_not_used(lead):
    """Except the first sample of each, with which the arm's wait begins anew."""
    samples = in_turn(numbered(9000, 200), numbered(9000 + lead, 200, "b"))
    accepted, changes = heard(samples)
    assert accepted[0] == changes[0]
    assert len(accepted) <= 2 * len(changes)
    gaps = np.diff([samples.index(change) for change in changes])
    assert gaps.min() >= 20  # stale_after_s


@given(st.lists(st.tuples(st.sampled_from("ab"), st.integers(0, 3)), min_size=5, max_size=300))
def test_samples_accepted_between_two_changes_are_of_one_publisher(turns):
    """Whatever the turns and the losses of both."""
    numbers = {"a": 5000, "b": 1}
    samples = []
    for name, lost in turns:
        numbers[name] += 1 + lost
        samples.append((name, numbers[name]))
    accepted, changes = heard(samples)
    of = None
    for sample in accepted:
        of = sample[0] if sample in changes else of
        assert sample[0] == of


def test_another_is_followed_once_only_it_has_published_for_a_time_or_comes_alone():
    accepted, changes = heard(numbered(9000, 50) + numbered(1, 50, "b"))
    assert changes[1:] == [("b", 21)]
    assert accepted == numbered(9000, 50) + numbered(21, 30, "b")
    watched = FollowedPublisher(0.2)
    watched.matched(1)
    assert not watched.accept(100, 0.0)
    watched.matched(0)
    watched.matched(1)
    assert watched.accept(1, 0.01)
    assert not watched.accept(2, 0.02)


def test_lost_samples_of_one_publisher_are_counted_by_their_numbers_and_are_no_other():
    samples = [sample for sample in numbered(1, 2000) if sample[1] % 7]
    assert heard(samples, publishers=1) == (samples, [])
    publisher = FollowedPublisher()
    for _, number in samples:
        publisher.accept(number, 0.0)
    report = status(fed(publisher=publisher), 1.0)
    assert (report.level, report.message) == (Level.WARN, LOST.format(285))
    assert publisher.lost == 0
