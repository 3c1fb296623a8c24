"""Stamps say how old a sample is, in which order, and how many lack."""

import pytest

from cablesense_ros.sample_clock import SampleClock
from cablesense_ros.sample_error import SampleError

MS = 1_000_000
NOW = 1_700_000_000_000 * MS


def test_the_age_of_a_sample():
    assert SampleClock(0.2).age_s(NOW - 5 * MS, NOW) == pytest.approx(0.005)


def test_a_sample_without_stamp_counts_as_new():
    clock = SampleClock(0.2)
    assert clock.age_s(0, NOW) == clock.age_s(0, NOW) == 0.0


@pytest.mark.parametrize(
    ("stamp", "complaint"),
    [
        (NOW - 201 * MS, "0.201 s old"),
        (NOW + 201 * MS, "ahead of this machine's clock"),
        (1, "old"),
    ],
)
def test_too_far_from_now(stamp, complaint):
    with pytest.raises(SampleError, match=complaint):
        SampleClock(0.2).age_s(stamp, NOW)


@pytest.mark.parametrize("back_ms", [0, 1, 150])
def test_stamps_must_ascend(back_ms):
    clock = SampleClock(0.2)
    clock.age_s(NOW, NOW)
    with pytest.raises(SampleError, match="must ascend"):
        clock.age_s(NOW - back_ms * MS, NOW)


def test_missing_samples_are_told_from_jitter():
    clock = SampleClock(60.0)
    for k in range(100):
        jitter = (k % 3 - 1) * MS
        if k not in (50, 51, 70):
            clock.age_s(NOW + 10 * MS * k + jitter, NOW)
    assert clock.missing_since_last_report() == 3
    assert clock.missing_since_last_report() == 0
