"""Error so far: only steady moments count, angles wrap, a wrong segment is its own error."""

import dataclasses

import numpy as np
import pytest

from cablesense_online.page.snapshot import (
    Contact,
    Level,
    Score,
    Snapshot,
    Status,
    angle_error_deg,
)

OK = Status(Level.OK, "fine")


def contact(segment=2, angle=350.0, newtons=40.0):
    return Contact(segment, angle, newtons, np.array([0.0, 0.0, newtons]))


def moment(time_s, true, estimate, status=OK, pose=0.0):
    return Snapshot(time_s, np.full(8, pose), np.full(12, 50.0), true, estimate, None, status)


def test_angles_wrap_around():
    assert angle_error_deg(359.0, 1.0) == pytest.approx(2.0)
    assert angle_error_deg(10.0, 200.0) == pytest.approx(170.0)


def test_errors_are_means_over_steady_moments():
    score = Score(settling_s=1.0)
    true, estimate = contact(angle=350.0, newtons=40.0), contact(angle=4.0, newtons=41.0)
    for time_s in np.arange(0.0, 3.0, 0.1):
        score.add(moment(time_s, true, estimate))
    errors = score.errors
    assert errors.segment_right == 1.0
    assert errors.angle_mae_deg == pytest.approx(14.0)
    assert errors.magnitude_mae_n == pytest.approx(1.0)
    assert errors.count == 20


def test_a_wrong_segment_counts_against_the_share_alone():
    score = Score(settling_s=0.0)
    score.add(moment(0.0, contact(2), contact(3)))
    score.add(moment(0.1, contact(2), contact(2)))
    assert score.errors.segment_right == 0.5
    assert score.errors.angle_mae_deg == 0.0


def test_silence_about_nothing_is_right_and_about_a_push_is_wrong():
    score = Score(settling_s=0.0)
    score.add(moment(0.0, None, None))
    assert score.errors.segment_right == 1.0
    assert score.errors.angle_mae_deg is None
    score.add(moment(1.0, contact(), None))
    assert score.errors.segment_right == 0.5


@pytest.mark.parametrize("change", ["load", "pose"])
def test_a_change_starts_the_settling_anew(change):
    score = Score(settling_s=1.0)
    before = moment(0.0, contact(), contact())
    score.add(before)
    assert score.add(dataclasses.replace(before, time_s=1.5))
    after = (
        moment(1.6, contact(newtons=60.0), contact())
        if change == "load"
        else moment(1.6, contact(), contact(), pose=0.05)
    )
    assert not score.add(after)
    assert not score.add(dataclasses.replace(after, time_s=2.5))
    assert score.add(dataclasses.replace(after, time_s=2.7))


def test_stale_estimates_are_not_judged():
    score = Score(settling_s=0.0)
    assert not score.add(moment(0.0, None, None, Status(Level.STALE, "silent")))
    assert score.errors.segment_right is None
