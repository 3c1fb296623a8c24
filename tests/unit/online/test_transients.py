"""A force that has just changed: by more than its intervals, faster than the arm comes to rest."""

from statistics import NormalDist

import numpy as np
import pytest

from cablesense_contact.estimate import Estimate
from cablesense_online.transients import RecentTorques, with_torque

HALF_N = 1.0
HALF_STD = NormalDist().inv_cdf(0.9995)
"""Half of an interval of 99.9 %."""
LEVER_M = 0.2
MS = 1_000_000
SWINGS_MS = 150


def contact(magnitude_n, angle_deg=90.0, segment=2):
    """With half a 99.9 % interval of its force of 1 N."""
    std_n = HALF_N / HALF_STD
    return Estimate(
        np.array([0.0, 0.0, 1.0]), segment, angle_deg, magnitude_n, std_n, 1.0, 0.0, 100.0
    )


def last_change(*samples):
    """Whether the last of samples (stamp in ms, estimate, lever) has changed just now."""
    recent = RecentTorques()
    has_changed = False
    for stamp_ms, estimate, lever_m in samples:
        recent, has_changed = with_torque(recent, estimate, lever_m, stamp_ms * MS)
    return has_changed


@pytest.mark.parametrize(
    ("step_n", "has_changed"), [(1.9 * HALF_N, False), (2.1 * HALF_N, True), (-2.1 * HALF_N, True)]
)
def test_a_force_has_changed_beyond_both_half_intervals(step_n, has_changed):
    first = (0, contact(10.0), LEVER_M)
    assert last_change(first, (10, contact(10.0 + step_n), LEVER_M)) is has_changed


@pytest.mark.parametrize(
    ("later_ms", "has_changed"), [(SWINGS_MS, True), (SWINGS_MS + 1, False), (-1, False)]
)
def test_only_samples_of_the_time_of_a_swing_count(later_ms, has_changed):
    """To its edge; a stamp that runs back has nothing before it."""
    assert (
        last_change((0, contact(2.0), LEVER_M), (later_ms, contact(9.0), LEVER_M)) is has_changed
    )


def test_a_slow_change_is_none_however_far_it_goes():
    recent = RecentTorques()
    for step in range(200):  # 1.5 N in the time of a swing, 20 N in all
        estimate = contact(10.0 + 0.1 * step)
        recent, has_changed = with_torque(recent, estimate, LEVER_M, step * 10 * MS)
        assert not has_changed
    assert len(recent.stamps_ns) == SWINGS_MS // 10 + 1


def test_a_force_that_turns_or_begins_has_changed():
    turned = (10, contact(10.0, angle_deg=120.0), LEVER_M)
    assert last_change((0, contact(10.0), LEVER_M), turned)
    assert last_change((0, contact(0.0, segment=0), LEVER_M), (10, contact(5.0), LEVER_M))


def test_a_contact_that_passes_to_the_next_segment_has_not_changed():
    """Its torque about the first joint stays, whichever segment it is on."""
    passed = (10, contact(10.0, segment=3), LEVER_M + 0.01)
    assert not last_change((0, contact(10.0), LEVER_M), passed)
