"""Blind, free, stale and contact are told apart, though the wrench is zero in three of them."""

import numpy as np
import pytest

from cablesense_online.admittance.estimate_watch import EstimateWatch, Sight, WatchSettings

SETTINGS = WatchSettings(stale_after_s=0.2, resume_after_s=1.0, settle_s=0.5)
REST, MOVED = np.zeros(8), np.full(8, 0.01)


class Estimator:
    """Plays 100 Hz of wrenches, and probabilities beside those that are estimates."""

    def __init__(self):
        self.now_s = 100.0
        self.watch = EstimateWatch(REST, SETTINGS, self.now_s)

    def says(self, seconds, contact=False, estimates=True, age_s=0.001):
        seen = []
        for _ in range(round(100 * seconds)):
            self.now_s += 0.01
            self.watch.heard_wrench(contact, age_s, self.now_s)
            if estimates:
                self.watch.heard_probabilities(self.now_s)
            seen.append(self.watch.look(self.now_s))
        return seen

    def silence(self, seconds):
        seen = []
        for _ in range(round(100 * seconds)):
            self.now_s += 0.01
            seen.append(self.watch.look(self.now_s))
        return seen


@pytest.fixture
def estimator():
    playing = Estimator()
    playing.says(1.5)
    return playing


def test_estimates_must_come_for_a_while_before_they_are_trusted():
    seen = Estimator().says(1.5)
    assert seen[80] is Sight.STOPPED
    assert seen[-1] is Sight.FREE


def test_a_contact_is_seen_at_once(estimator):
    assert estimator.says(0.02, contact=True)[-1] is Sight.CONTACT
    assert estimator.says(0.5)[-1] is Sight.FREE


def test_zeros_after_a_command_are_blindness_and_not_freedom(estimator):
    estimator.watch.commanded(MOVED, estimator.now_s)
    seen = estimator.says(0.58, estimates=False)
    assert set(seen) == {Sight.BLIND}
    assert estimator.says(0.1)[-1] is Sight.FREE


def test_an_estimator_that_answers_while_the_arm_moves_is_believed(estimator):
    estimator.watch.commanded(MOVED, estimator.now_s)
    assert set(estimator.says(0.5, contact=True)) == {Sight.CONTACT}


def test_zeros_for_longer_than_a_move_takes_are_a_fault(estimator):
    estimator.watch.commanded(MOVED, estimator.now_s)
    seen = estimator.says(0.6 + 0.2 + 0.1, estimates=False)
    assert seen[-1] is Sight.STOPPED
    assert "no estimate" in estimator.watch.reason


def test_silence_stops_within_the_limit_and_estimates_resume(estimator):
    seen = estimator.silence(0.3)
    assert seen[18] is not Sight.STOPPED
    assert seen[21] is Sight.STOPPED
    assert "no wrench" in estimator.watch.reason
    assert not estimator.watch.speaking(estimator.now_s)
    assert estimator.says(0.9)[-1] is Sight.STOPPED
    assert estimator.says(0.2)[-1] is Sight.FREE


def test_old_stamps_are_silence(estimator):
    assert estimator.says(0.3, age_s=0.25)[-1] is Sight.STOPPED


def test_the_estimators_own_word_of_stale_samples_stops_until_estimates_come(estimator):
    estimator.silence(0.05)
    estimator.watch.heard_of_input(True, estimator.now_s)
    assert estimator.watch.look(estimator.now_s) is Sight.STOPPED
    assert "stale" in estimator.watch.reason
    assert estimator.says(1.2)[-1] is Sight.FREE


def test_a_refused_message_stops(estimator):
    estimator.watch.refused("a wrench was refused: nan")
    assert estimator.says(0.01)[-1] is Sight.STOPPED
    assert "nan" in estimator.watch.reason
    assert estimator.says(1.2)[-1] is Sight.FREE
