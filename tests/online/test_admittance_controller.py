"""The controller's cycle: when it steps, and above all when it does not."""

import numpy as np
import pytest

from cablesense_msgs_py.messages import ForceState, Level
from cablesense_online.admittance.controller import AdmittanceController
from cablesense_online.admittance.estimate_watch import ContactState
from cablesense_online.admittance.law import AdmittanceSettings
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of

ARM = mechanism_of(open_arm("cdsm"))
CLOCK_OFFSET_NS = 1_700_000_000_000_000_000
PUSH = np.array([0.0, 30.0, 0.0])
NONE = np.zeros(3)


class Played:
    """Estimates at 100 Hz; every command comes back, as on a topic, and moves time on."""

    def __init__(self, mute_s=0.6, **settings):
        self.now_s, self.mute_s, self.mute_until_s = 50.0, mute_s, 0.0
        given = AdmittanceSettings(**{"resume_after_s": 0.3, **settings})
        self.controller = AdmittanceController(ARM, given, self.now_s)
        self.sent = []

    def run(self, seconds, segment=0, force=NONE, age_s=0.002):
        for _ in range(round(100 * seconds)):
            self.now_s += 0.01
            clock_ns = CLOCK_OFFSET_NS + round(self.now_s * 1e9)
            seeing, state = self.now_s >= self.mute_until_s, ForceState.MOVING
            if seeing:
                state = ForceState.CONTACT if segment else ForceState.FREE
            command = self.controller.received(
                state,
                segment if seeing else 0,
                force if seeing else NONE,
                clock_ns - round(age_s * 1e9),
                clock_ns,
                self.now_s,
            )
            if command is not None:
                self.sent.append((self.now_s, command))
                self.controller.received_command(command, self.now_s)
                self.mute_until_s = self.now_s + self.mute_s
        return self.sent

    def message(self, active=True):
        return self.controller.status(active, 1, self.now_s)


def test_nothing_is_sent_while_nothing_touches_at_home():
    assert not Played().run(3.0)


def test_a_contact_is_left_in_cycles_of_move_settle_and_measure():
    played = Played()
    played.run(0.5)
    sent = played.run(3.0, 3, PUSH)
    assert len(sent) == pytest.approx(4, abs=1)
    assert np.diff([when for when, _ in sent]).min() > 0.65
    yaw = [command[3] for _, command in sent]
    assert (np.diff([0.0, *yaw]) > 0.0).all()
    assert played.message().level is Level.OK


def test_an_estimator_that_is_never_mute_makes_the_cycle_shorter():
    played = Played(mute_s=0.0)
    played.run(0.5)
    sent = played.run(3.0, 3, PUSH)
    assert np.sort(np.diff([when for when, _ in sent]))[-2] < 0.3  # one confirms the contact


def turned_deg(played):
    return np.rad2deg(np.abs(played.controller.command_rad - played.controller.home_rad).max())


def test_a_contact_is_yielded_to_by_little_until_it_is_seen_in_another_pose():
    played = Played()
    played.run(0.5)
    played.run(1.2, 3, 3.0 * PUSH)
    assert turned_deg(played) == pytest.approx(0.45)
    assert "not confirmed" in played.message().message
    played.run(2.0, 3, 3.0 * PUSH)
    assert turned_deg(played) > 1.0
    assert "not confirmed" not in played.message().message


@pytest.mark.parametrize("other", [(1, PUSH), (3, -PUSH), (3, 3.0 * PUSH)])
def test_a_confirmed_contact_does_not_vouch_for_another(other):
    played = Played()
    played.run(0.5)
    played.run(4.0, 3, PUSH)
    before = played.controller.command_rad
    played.run(1.5, *other)
    assert np.rad2deg(np.abs(played.controller.command_rad - before).max()) < 0.46


def test_an_unconfirmed_contact_stops_it():
    played = Played()
    played.run(0.5)
    played.run(0.6, 3, PUSH)
    sent, clock_ns = len(played.sent), CLOCK_OFFSET_NS
    for _ in range(100):
        played.now_s += 0.01
        clock_ns = CLOCK_OFFSET_NS + round(played.now_s * 1e9)
        doubted = (ForceState.UNCONFIRMED, 3, PUSH, clock_ns, clock_ns, played.now_s)
        assert played.controller.received(*doubted) is None
    assert played.controller.watch.state is ContactState.STOPPED
    assert "unconfirmed" in played.message().message
    assert len(played.sent) == sent


def test_estimates_from_before_the_arm_arrived_do_not_count():
    played = Played(mute_s=0.0)
    played.run(0.5)
    first = played.run(0.2, 3, PUSH)[0][0]
    sent = played.run(0.5, 3, PUSH)
    assert sent[1][0] - first >= 0.1 + 0.1 - 0.011  # shortest move, then the measurement


def test_nothing_is_sent_before_estimates_are_trusted():
    assert not Played().run(0.25, 3, PUSH)


def test_old_stamps_stop_it():
    played = Played()
    played.run(0.5)
    assert not played.run(1.0, 3, PUSH, age_s=0.3)
    assert played.controller.watch.state is ContactState.STOPPED
    assert played.message().level is Level.ERROR
    assert "no state of the force with a fresh stamp" in played.message().message


def test_no_step_is_taken_while_friction_may_hide_a_force():
    played = Played(mute_s=0.0)
    played.run(0.5)
    played.run(1.0, 3, PUSH)
    moved = len(played.sent)
    for _ in range(300):
        played.now_s += 0.01
        clock_ns = CLOCK_OFFSET_NS + round(played.now_s * 1e9)
        hidden = (ForceState.HIDDEN, 0, NONE, clock_ns, clock_ns, played.now_s)
        assert played.controller.received(*hidden) is None
    assert moved
    assert played.message().level is Level.OK
    assert played.run(1.0)  # free: home


def test_another_nodes_command_becomes_home_and_silences_it():
    played = Played(yield_s=1.0)
    played.run(0.5)
    elsewhere = np.full(8, 0.02)
    assert played.controller.received_command(elsewhere, played.now_s)
    assert not played.run(0.95, 3, PUSH)
    assert "another node commands" in played.message().message
    sent = played.run(0.5, 3, PUSH)
    assert np.abs(sent[0][1] - elsewhere).max() < np.deg2rad(1.01)
    assert np.array_equal(played.controller.home_rad, elsewhere)


def test_its_own_commands_are_no_other_nodes_even_when_received_late():
    played = Played()
    played.run(0.5)
    played.run(2.0, 3, PUSH)
    for _, command in played.sent:
        assert not played.controller.received_command(command, played.now_s)


def test_it_takes_no_step_from_beyond_its_reach():
    played = Played(yield_s=0.0)
    played.run(0.5)
    played.controller.received_command(np.full(8, 0.2), played.now_s)
    played.run(2.0, 3, PUSH)
    assert not played.sent
    assert "beyond joint_limit_deg" in played.message().message


def test_it_waits_for_a_first_command_when_asked_to():
    played = Played(await_command=True)
    assert not played.run(2.0, 3, PUSH)
    assert "first command" in played.message().message
    played.controller.received_command(np.zeros(8), played.now_s)
    assert played.run(1.0, 3, PUSH)


def test_it_never_leaves_its_reach_however_long_it_is_pushed():
    limit_rad = float(np.deg2rad(2.0))
    played = Played(joint_limit_rad=limit_rad, step_limit_rad=0.1, speed_limit_rad_s=1.0)
    played.run(0.5)
    played.run(30.0, 1, 50.0 * PUSH)
    last = played.sent[-1][1]
    assert np.hypot(last[0], last[1]) == pytest.approx(np.deg2rad(2.0))
    assert "joint_limit_deg" in played.message().message


def test_the_command_in_force_is_repeated_for_an_estimator_that_came_back():
    played = Played()
    assert played.controller.repeated(played.now_s) is None
    played.run(0.5)
    played.run(1.0, 3, PUSH)
    held = played.sent[-1][1]
    played.now_s += 1.0
    assert played.controller.repeated(played.now_s) is None  # nothing is published
    played.run(0.05)
    assert np.array_equal(played.controller.repeated(played.now_s), held)
    assert played.controller.repeated(played.now_s) is None  # not at once again
    assert not played.message(active=False).message.startswith("stopped")
