"""One measurement: spans its time, has no gaps, and doubt weakens it."""

import numpy as np
import pytest

from cablesense_online.admittance.law import ForceAverage

FORCE = np.array([0.0, 3.0, 4.0])


def filled(samples, period_ms=10):
    average = ForceAverage(0.1, 0.2)
    for k, (segment, force) in enumerate(samples):
        average.add(1_000_000 * period_ms * k, segment, force)
    return average


def test_it_is_complete_once_it_spans_its_time():
    assert not filled([(3, FORCE)] * 10).complete
    assert filled([(3, FORCE)] * 11).complete


def test_slow_sensors_give_three_samples_at_least():
    assert not filled([(3, FORCE)] * 2, period_ms=150).complete
    assert filled([(3, FORCE)] * 3, period_ms=150).complete


def test_the_mean_of_equal_samples_is_the_sample_and_it_begins_anew():
    average = filled([(3, FORCE)] * 11)
    segment, mean = average.take()
    assert segment == 3
    assert mean == pytest.approx(FORCE)
    assert not average.complete


def test_samples_without_contact_or_on_another_segment_weaken_it():
    segment, mean = filled([(3, FORCE)] * 6 + [(0, np.zeros(3))] * 4 + [(2, FORCE)] * 2).take()
    assert segment == 3
    assert mean == pytest.approx(0.5 * FORCE)


def test_no_contact_in_any_sample_is_no_contact():
    segment, mean = filled([(0, np.zeros(3))] * 11).take()
    assert segment == 0
    assert not mean.any()


@pytest.mark.parametrize("stamp_ns", [400_000_000, 90_000_000])
def test_a_gap_or_a_stamp_that_goes_back_begins_anew(stamp_ns):
    average = filled([(3, FORCE)] * 11)
    average.add(stamp_ns, 3, FORCE)
    assert not average.complete
