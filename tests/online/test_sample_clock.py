"""Stamps say how old a sample is, in which order, and how many lack."""

import numpy as np
import pytest

from cablesense_online.samples import SampleClock, SampleError

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


def reports(period_ms, late_ms, lost=(), seconds=12):
    """What each second's report says; `late_ms` gives each sample's jitter by its number."""
    clock, said = SampleClock(60.0), []
    per_report = round(1000 / period_ms)
    for number in range(seconds * per_report):
        if number not in lost:
            clock.age_s(round(NOW + (number * period_ms + late_ms(number)) * MS), NOW)
        if (number + 1) % per_report == 0:
            said.append(clock.missing_since_last_report())
    return said


def test_missing_samples_are_told_once():
    said = reports(10, lambda number: number % 3, lost={350, 351, 370, 777})
    assert sum(said) == 4
    assert sum(said[3:5]) == 3
    assert sum(said[7:9]) == 1


def test_none_lack_where_all_came():
    assert not any(reports(1, lambda _: 0.0))


@pytest.mark.parametrize("pause_ms", [3, 20, 150])
def test_samples_that_come_in_bursts_are_not_missing(pause_ms):
    # held up, and then all at once, a microsecond after the other
    rng = np.random.default_rng(pause_ms)
    ends = np.cumsum(rng.integers(1, pause_ms, 12_000))

    def late_ms(number):
        end = ends[np.searchsorted(ends, number)]
        return max(0.0, (end - number) * (1.0 - 1e-3))

    assert sum(reports(1, late_ms)) <= 1


def test_losses_are_told_among_bursts():
    def late_ms(number):
        return (30 - number % 30) * 0.999

    lost = set(range(5010, 5110))
    assert sum(reports(1, late_ms, lost)) == pytest.approx(100, abs=2)


def test_a_silence_is_not_counted_as_missing_samples():
    clock = SampleClock(60.0)
    for second in (0, 1, 10, 11):
        for number in range(100):
            clock.age_s(NOW + (second * 1000 + number * 10) * MS, NOW)
        assert clock.missing_since_last_report() == 0
        if second == 1:
            assert clock.missing_since_last_report() == 0  # a second without any
