"""Stuck channels: standing still is no fault, standing still while the others move is."""

import numpy as np
import pytest

from cablesense_online.can.channel_map import StuckLimits
from cablesense_online.can.tension_reader import StuckDetector

LIMITS = StuckLimits(after_s=2.0, others_moved_n=20.0)


@pytest.fixture
def watch():
    return StuckDetector(12, LIMITS)


def play(watch, samples, start_s=0.0, step_s=0.1):
    return [watch.stuck(sample, start_s + i * step_s) for i, sample in enumerate(samples)]


def test_a_resting_arm_is_not_stuck(watch):
    assert set(play(watch, [np.full(12, 50.0)] * 100)) == {()}


def test_a_channel_that_stands_still_while_the_others_move_is_found_and_released(watch):
    moving = np.linspace(50.0, 100.0, 40)[:, None] * np.ones(12)
    moving[:, 4] = 50.0
    found = play(watch, moving)
    assert found[19] == ()  # two seconds have not passed
    assert found[-1] == (4,)
    back = np.full(12, 50.0)
    assert watch.stuck(back, 5.0) == (4,)  # the others came back; it has still not moved
    back[4] = 50.1
    assert watch.stuck(back, 5.1) == ()


def test_few_others_that_move_prove_nothing(watch):
    moving = np.full((40, 12), 50.0)
    moving[:, :5] += np.linspace(0.0, 50.0, 40)[:, None]
    assert set(play(watch, moving)) == {()}


def test_a_restart_forgets(watch):
    moving = np.linspace(50.0, 100.0, 40)[:, None] * np.ones(12)
    moving[:, 4] = 50.0
    play(watch, moving)
    watch.restart()
    assert watch.stuck(moving[-1], 9.0) == ()


def test_a_lone_channel_is_never_stuck():
    assert set(play(StuckDetector(1, LIMITS), [np.array([50.0])] * 100)) == {()}
