"""The errors that the page adds up: means over instants at rest, misses among them."""

import dataclasses

import numpy as np
import pytest

from cablesense_msgs_py.messages import Contact, ForceState, Level
from cablesense_online.page.figures import html
from cablesense_online.page.headline import Words
from cablesense_online.page.score import GUESS_DEG, Score
from cablesense_online.page.snapshot import ShownStatus, Snapshot

EVERYWHERE = np.tile(np.eye(2), (4, 1, 1))
WORDS = Words("arm", "segment", ("1", "2", "3", "4"))


def contact(segment=2, angle=350.0, newtons=40.0, place_m=0.08):
    return Contact(segment, angle, newtons, place_m)


def instant(time_s, true, estimated, pose=0.0, state=None):
    state = state or (ForceState.CONTACT if estimated else ForceState.FREE)
    pose = np.full(8, pose)
    tensions = np.full(12, 50.0)
    fine = ShownStatus(Level.OK, "fine")
    contacts = tuple(true), state, tuple(estimated)
    return Snapshot(time_s, pose, pose, tensions, *contacts, None, None, fine)


def scored(*instants):
    score = Score(EVERYWHERE, settling_s=0.0)
    for one in instants:
        score.add(one)
    return score.errors


def test_errors_are_means_over_steady_instants():
    score = Score(EVERYWHERE, settling_s=1.0)
    true = [contact(angle=350.0)]
    estimate = [contact(angle=4.0, newtons=41.0, place_m=0.083)]
    for time_s in np.arange(0.0, 3.0, 0.1):
        score.add(instant(time_s, true, estimate))
    assert score.errors == pytest.approx((20, 0, 0.0, 1.0, None, 0.003, 14.0, 1.0))
    score.reset()
    assert score.errors == (0, 0, *[None] * 6)


def test_right_segments_are_counted_under_pushes_alone_and_false_contacts_without_one():
    untouched = [instant(0.1 * n, [], []) for n in range(30)]
    errors = scored(*untouched)
    assert (errors.pushed, errors.untouched) == (0, 30)
    assert (errors.segment_right, errors.false_contacts) == (None, 0.0)
    wrong = instant(4.0, [contact(2)], [contact(3)])
    right = instant(5.0, [contact(2)], [contact(2)])
    ghosts = [instant(6.0 + n, [], [contact(1)]) for n in range(10)]
    errors = scored(*untouched, wrong, right, *ghosts)
    assert (errors.pushed, errors.untouched) == (2, 40)
    assert (errors.segment_right, errors.false_contacts) == (0.5, 0.25)
    shown = html("figures", None, errors, WORDS)
    assert "over 2 instants of pushes at rest; untouched, 25.0 % of 40 showed a contact" in shown
    assert "over 0 instants of pushes" in html("figures", None, scored(), WORDS)


@pytest.mark.parametrize(
    ("true", "estimated", "angle_deg", "force_n"),
    [
        ([contact(2)], [contact(3, newtons=70.0)], GUESS_DEG, 70.0),
        ([contact(2)], [], GUESS_DEG, 40.0),
        ([], [contact(3, newtons=7.0)], None, 7.0),
    ],
)
def test_misses_and_wrong_segments_count_with_all_of_their_force(
    true, estimated, angle_deg, force_n
):
    wrong = instant(0.0, true, estimated)
    assert scored(wrong)[5:] == (None, angle_deg, force_n)
    errors = scored(wrong, instant(0.1, [contact(2)], [contact(2)]))
    assert errors.magnitude_mae_n == 0.5 * force_n


def test_of_a_known_moment_segment_and_direction_count_and_neither_place_nor_force():
    state = ForceState.MOMENT
    seen = Contact(2, 352.0, moment_n_m=3.2)
    now = dataclasses.replace(instant(0.0, [contact(2)], [], state=state), known_by_moment=seen)
    assert scored(now) == pytest.approx((1, 0, 0.0, 1.0, None, None, 2.0, None))
    elsewhere = dataclasses.replace(now, known_by_moment=seen._replace(segment=1))
    assert scored(elsewhere)[3:] == (0.0, None, None, GUESS_DEG, 40.0)


def test_moments_without_an_answer_are_counted_apart_and_those_in_motion_not_at_all():
    states = (ForceState.HIDDEN, ForceState.SILENT, ForceState.MOVING, ForceState.REFUSED)
    silent = [instant(0.0, [contact()], [], state=state) for state in states]
    assert scored(*silent).segment_right is None
    errors = scored(*silent, instant(0.0, [contact()], [contact()]))
    assert (errors.unanswered, errors.pushed) == (0.75, 1)


def test_what_is_not_felt_of_a_force_is_not_missed():
    upwards_alone = np.tile(np.diag([0.0, 1.0]), (4, 1, 1))
    score = Score(upwards_alone, settling_s=0.0)
    score.add(
        instant(0.0, [contact(angle=60.0, newtons=40.0)], [contact(angle=0.0, newtons=20.0)])
    )
    assert score.errors.angle_mae_deg == pytest.approx(0.0)
    assert score.errors.magnitude_mae_n == pytest.approx(0.0)
