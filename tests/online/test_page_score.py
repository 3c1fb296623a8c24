"""The errors that the page adds up: means over moments at rest, misses among them."""

import dataclasses

import numpy as np
import pytest

from cablesense_msgs_py.messages import ForceState, Level
from cablesense_online.page.live_arm import ShownContact, ShownStatus, Snapshot
from cablesense_online.page.score import GUESS_DEG, Score, angle_error_deg

FINE = ShownStatus(Level.OK, "fine")


def contact(segment=2, angle=350.0, newtons=40.0):
    return ShownContact(segment, angle, newtons, np.array([0.0, 0.0, newtons]))


def moment(time_s, true, estimate, pose=0.0, state=None):
    state = state or (ForceState.CONTACT if estimate else ForceState.FREE)
    return Snapshot(
        time_s, np.full(8, pose), np.full(12, 50.0), true, state, estimate, None, None, FINE
    )


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


def test_several_contacts_are_compared_segment_by_segment():
    score = Score(settling_s=0.0)
    whole = dataclasses.replace(
        moment(0.0, contact(4, newtons=30.0), contact(4, newtons=31.0)),
        more_true=(contact(2, newtons=10.0),),
        more_estimated=(contact(2, newtons=12.0),),
    )
    score.add(whole)
    assert score.errors.segment_right == 1.0
    assert score.errors.magnitude_mae_n == pytest.approx(1.5)
    score.add(dataclasses.replace(whole, more_estimated=()))
    assert score.errors.segment_right == 0.5
    assert score.errors.magnitude_mae_n == pytest.approx((1.0 + 2.0 + 1.0 + 10.0) / 4)
    assert score.errors.angle_mae_deg == pytest.approx(GUESS_DEG / 4)


@pytest.mark.parametrize(
    ("true", "estimate", "angle_deg", "force_n"),
    [
        (contact(2), contact(3, newtons=70.0), GUESS_DEG, 70.0),
        (contact(2), None, GUESS_DEG, 40.0),
        (None, contact(3, newtons=7.0), None, 7.0),
    ],
)
def test_misses_and_wrong_segments_count_with_all_of_their_force(
    true, estimate, angle_deg, force_n
):
    score = Score(settling_s=0.0)
    score.add(moment(0.0, true, estimate))
    assert score.errors.segment_right == 0.0
    assert score.errors.angle_mae_deg == angle_deg
    assert score.errors.magnitude_mae_n == force_n
    score.add(moment(0.1, contact(2), contact(2)))
    assert score.errors.segment_right == 0.5
    assert score.errors.magnitude_mae_n == 0.5 * force_n


def test_silence_about_nothing_is_right_and_is_no_error_of_a_force():
    score = Score(settling_s=0.0)
    score.add(moment(0.0, None, None))
    assert score.errors.segment_right == 1.0
    assert score.errors.angle_mae_deg is score.errors.magnitude_mae_n is None


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


def test_moments_without_an_answer_are_counted_apart_and_those_in_motion_not_at_all():
    score = Score(settling_s=0.0)
    for state in (ForceState.HIDDEN, ForceState.SILENT, ForceState.MOVING, ForceState.REFUSED):
        score.add(moment(0.0, contact(), None, state=state))
    assert score.errors.segment_right is None
    score.add(moment(0.0, contact(), contact()))
    assert (score.errors.unanswered, score.errors.count) == (0.75, 1)
