"""States and samples alone give the answers again: whatever happened when, from any state on."""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from joint_commands import cable_offsets
from sample_feed import ARM, Feed, message_bytes

from cablesense_base import CableSenseError
from cablesense_msgs_py.messages import BREATH_END, NO_CONTACT
from cablesense_online.state import Event, EventKind
from cablesense_online.stated_contacts import RestingArm
from cablesense_training.inference.estimator import Estimate

pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark


class EveryBit:
    """An answer in which every bit of the difference and of the command shows."""

    pose_aware = True

    def estimate(self, tension_difference_n, joint_command_rad):
        weights = np.arange(1.0, 13.0)
        return Estimate(
            np.array([0.25, 0.0, 0.75, 0.0, 0.0]),
            2,
            float(weights[:8] @ joint_command_rad),
            100.0 + float(weights @ tension_difference_n),
            1.0,
            1.0,
            90.0,
            110.0,
        )


def every_bit():
    """Some of the commands of a run are followed, some are not."""
    follow = {"still_rad": 1e-4, "follow_rad_s": 0.03}
    return Feed(EveryBit(), tare_samples=4, settle_s=0.05, **follow)


def live_run(seed, count=120):
    """Samples in order with their answers, while commands and tares come between them."""
    rng = np.random.default_rng(seed)
    feed, run = every_bit(), []
    live, stamp = feed.estimation, 10**18
    for step in range(count):
        chance = rng.random()
        if chance < 0.05:
            feed.command(rng.choice([0.2, 1.0]) * rng.uniform(-0.004, 0.004, 8))
        elif chance < 0.15:
            with suppress(CableSenseError):
                live.take_tare(stamp, forced=True) if chance < 0.12 else live.undo_tare()
        elif chance < 0.17:
            live.adjust(float(rng.uniform(0.0, 1.0)), 0.2, 1.0)
        elif chance < 0.2:
            turn = int(rng.integers(BREATH_END, 3))
            live.offset(cable_offsets(ARM, np.zeros(12), turn, stamp))
        elif chance < 0.21:
            live.publisher.matched(0)  # its publisher leaves; the next sample is of another
        stamp += 10_000_000 if rng.random() < 0.98 else int(rng.choice([-1, 3])) * 1_000_000_000
        tensions = 100.0 + rng.uniform(-0.5, 0.5, 12)
        if rng.random() < 0.05:
            tensions[3] = np.nan
        raw = message_bytes(tensions, stamp)
        live.follow(step, 0.01 * step)
        run.append((raw, stamp, live.sample(raw, stamp + 3_000_000, 0.01 * step)))
    return run


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1), begin=st.integers(0, 119))
@example(seed=1422224538, begin=76)  # between commands of a followed motion
@settings(max_examples=4, deadline=None)
def test_the_last_state_and_the_samples_are_enough_from_anywhere(seed, begin):
    run = live_run(seed)
    states = [answer.state for *_, answer in run[: begin + 1] if answer.state is not None]
    other = every_bit().estimation

    def go_on(state):
        other.adjust(state.settings.contact_threshold, 0.2, 1.0)
        other.restore(state)

    go_on(states[-1])
    for raw, stamp, answer in run[begin:]:
        if answer.state is not None:
            go_on(answer.state)
        again = other.sample(raw, stamp, stamp * 1e-9)
        assert (again.contact, again.force) == (answer.contact, answer.force)


def test_a_state_comes_with_the_first_sample_after_a_change():
    feed, events = every_bit(), []
    feed.estimation.start(0.0)  # again, before the first sample
    for i in range(12):
        if i == 8:
            feed.estimation.take_tare(feed.now_ns, forced=True)
            feed.estimation.undo_tare()
        if i == 10:
            for angle in (0.01, 0.02, 0.02):
                feed.command([angle] * 8)
        if i == 11:
            feed.estimation.adjust(0.7, 0.2, 1.0)
        state = feed.sample().state
        if state is not None:
            assert state.before_ns == feed.now_ns
            events.append((i, list(state.events)))
    assert events == [
        (0, [Event(EventKind.START, (0.0,) * 8)]),
        (4, [Event(EventKind.AUTO_TARE)]),
        (8, [Event(EventKind.TARE), Event(EventKind.TARE_UNDO)]),
        (10, [Event(EventKind.COMMAND, (angle,) * 8) for angle in (0.01, 0.02)]),
        (11, [Event(EventKind.SETTINGS)]),
    ]
    assert state.settings.contact_threshold == 0.7
    assert state.origin["joints"].split() == list(ARM.joint_names)
    assert feed.estimation.gate.state.rest_from_ns > feed.now_ns


@pytest.mark.parametrize("confirmed", [False, True])
def test_a_tare_before_any_command_is_dropped_after_a_restart_too(confirmed):
    feed = Feed(tare_deviation_n=2.0).tared()
    state = feed.sample().state
    if confirmed:
        feed.command(np.zeros(8))
        state = feed.sample().state
    again = Feed(tare_deviation_n=2.0)
    again.estimation.restore(state)
    assert again.sample().contact == NO_CONTACT
    again.command(np.deg2rad([0.0, 0.0, 8.0, 0.0, 6.0, 0.0, 0.0, 0.0]))
    assert (again.estimation.tares.present is not None) is confirmed
    assert again.estimation.tares.automatic is not confirmed


def test_another_arm_carries_the_tare_over_by_its_own_model():
    feed = every_bit()
    for _ in range(5):
        state = feed.sample(np.full(12, 100.0)).state
    there = {"command_rad": np.full(8, 0.01), "pose_rad": np.full(8, 0.01)}
    moved = state.model_copy(update={"gate": state.gate.model_copy(update=there)})
    same, other = every_bit().estimation, every_bit().estimation
    same.restore(moved)
    other.restore(moved.model_copy(update={"arm": "another"}))
    measured_n = state.tare.tare.measured_n
    np.testing.assert_array_equal(same.tares.unloaded_n, measured_n)
    gone = other.tares.unloaded_n - measured_n
    predict_n = RestingArm(ARM, 1).predict_n
    np.testing.assert_allclose(
        gone, predict_n(np.full(8, 0.01)) - predict_n(np.zeros(8)), atol=1e-9
    )
