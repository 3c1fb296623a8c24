"""Impossible stamps and readings are refused; missing samples are counted and reported."""

import math
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_contact.felt import ChannelLimits
from cablesense_msgs_py.messages import ForceState, Level
from cablesense_online.answer import Answer
from cablesense_online.contact_estimator import Sample
from cablesense_online.followed_publisher import FollowedPublisher
from cablesense_online.samples import ProblemKind, ReadingLimits, SampleError, Stamps, slack_cables
from cablesense_online.statuses import SampleCounts

MS = 1_000_000
NOW = 1_700_000_000_000 * MS

LOST = (
    "{} samples lost on the way, or left out as they came faster than answers; the others are used"
)


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
    stamps = Stamps().accepted(0, NOW, 0.2)  # without a stamp: counts as new, until one has come
    if before:
        stamps = stamps.accepted(before, NOW + 5 * MS, 0.2)
    with pytest.raises(SampleError, match=complaint) as caught:
        stamps.accepted(stamp, NOW, 0.2)
    assert caught.value.kind is ProblemKind.CLOCK


def test_stamps_step_back_where_the_clock_does():
    hour_ago = NOW - 3600_000 * MS
    stamps = Stamps().accepted(NOW, NOW, 0.2).accepted(hour_ago, hour_ago + MS, 0.2)
    assert (
        stamps.accepted(hour_ago + 10 * MS, hour_ago + 10 * MS, 0.2).last_ns == hour_ago + 10 * MS
    )


GOOD = [50.0] * 12


def limits(range_n):
    low, high = range_n or (-math.inf, math.inf)
    names = tuple(f"cable_{n}" for n in range(1, 13))
    channels = ChannelLimits(names, ("N",) * 12, np.full(12, low), np.full(12, high))
    return ReadingLimits(channels)


def changed(cable, tension):
    return [*GOOD[: cable - 1], tension, *GOOD[cable:]]


@pytest.mark.parametrize(
    ("range_n", "tension", "kind"),
    [
        *((None, value, ProblemKind.NOT_FINITE) for value in (math.nan, math.inf, -math.inf)),
        *((None, value, ProblemKind.IMPLAUSIBLE) for value in (-21.0, 1e5, 1e308)),
        *(((0.0, 500.0), value, ProblemKind.SATURATED) for value in (500.0, 501.0, -1.0)),
        ((-50.0, 500.0), -50.0, ProblemKind.SATURATED),
    ],
)
@pytest.mark.parametrize("cable", [1, 12])
def test_readings_that_no_cable_carries_are_refused_by_cable(cable, range_n, tension, kind):
    with pytest.raises(SampleError, match=f"cable_{cable} ") as caught:
        limits(range_n).check(changed(cable, tension))
    assert caught.value.kind is kind


def test_slack_cables_are_named_and_no_fault():
    limits(None).check(changed(3, -1.0))
    limits((0.0, 500.0)).check(changed(3, 0.0))
    units = ["N"] * len(GOOD)
    assert slack_cables(changed(3, -1.0), units, 1.0) == (3,)
    assert slack_cables(GOOD, units, 1.0) == ()
    units[2] = "N·m"
    assert slack_cables(changed(3, -1.0), units, 1.0) == ()


def status(counts, now_s, missing=0, publishers=1):
    return counts.status(now_s, missing, publishers, stale_after_s=0.2)


def fed(age_ns=0):
    counts = SampleCounts(0.0)
    for k in range(100):
        arrive(counts, 0.01 * (k + 1), age_ns)
    return counts


def arrive(counts, now_s, age_ns=0):
    answer = Answer(force=ForceState.FREE, probabilities=(1.0, 0.0), stamp_ns=NOW - age_ns)
    counts.count(Sample(b"", NOW, now_s), answer)


def test_rate_age_losses_and_silence_are_reported():
    report = status(fed(age_ns=4 * MS), 1.0)
    assert report.level is Level.OK
    assert report.values["rate (Hz)"] == "100.0"
    assert report.values["largest age (s)"] == "0.0040"
    assert status(fed(), 1.0, missing=3).message == LOST.format(3)
    assert status(SampleCounts(0.0), 1.0).message == "no sample received yet"
    report = status(fed(), 3.0)
    assert (report.level, report.message) == (Level.STALE, "no sample for 2.0 s")


def test_refused_samples_are_an_error_until_the_next_report():
    counts = fed()
    counts.refuse(SampleError(ProblemKind.NOT_FINITE, "effort of cable_3 is nan N"))
    report = status(counts, 1.0)
    assert report.level is Level.ERROR
    assert "1 not finite" in report.message
    assert "cable_3" in report.values["last refusal"]
    arrive(counts, 1.05)
    again = status(counts, 1.1)
    assert again.level is Level.OK
    assert again.values["refused in all"] == "1"


def test_a_silent_second_publisher_is_a_warning_and_one_that_publishes_an_error():
    counts = fed()
    assert status(counts, 1.0, publishers=2).level is Level.WARN
    counts.refuse(SampleError(ProblemKind.PUBLISHER, "its publisher's number 3"))
    assert status(counts, 1.1, publishers=2).level is Level.ERROR


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
    assert publisher.lost == 285
