"""The controller steps on trusted, fresh, confirmed contacts, and on nothing else."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

from cablesense_msgs_py.messages import ForceState, Level
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from examples.admittance.controller import AdmittanceController
from examples.admittance.law import AdmittanceSettings
from examples.admittance.trust import FORCE_KNOWN, ContactState

ARM = mechanism_of(open_arm("cdsm"))
CLOCK_OFFSET_NS = 1_700_000_000_000_000_000
PUSH = np.array([0.0, 30.0, 0.0])
NONE = np.zeros(3)


class Played:
    """Estimates at 100 Hz; every command comes back, as on a topic, and mutes the estimator."""

    def __init__(self, mute_s=0.6, **settings):
        self.now_s = 50.0
        self.mute_s = mute_s
        self.mute_until_s = 0.0
        given = AdmittanceSettings(**{"resume_after_s": 0.3, **settings})
        self.controller = AdmittanceController(ARM, given, self.now_s)
        self.sent = []

    def run(self, seconds, segment=0, force=NONE, age_s=0.002, state=None):
        """The commands so far; a contact by its force, else the `state`."""
        for _ in range(round(100 * seconds)):
            self.now_s += 0.01
            clock_ns = CLOCK_OFFSET_NS + round(self.now_s * 1e9)
            stated = state or (ForceState.CONTACT if segment else ForceState.FREE)
            seeing = self.now_s >= self.mute_until_s
            command = self.controller.received(
                stated if seeing else ForceState.MOVING,
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

    def verdict(self):
        return self.controller.verdict(self.now_s)

    def turned_deg(self, from_rad=0.0):
        return np.rad2deg(np.abs(self.controller.command_rad - from_rad).max())


def test_nothing_is_sent_at_home_without_contact_or_before_estimates_are_trusted():
    assert not Played().run(3.0)
    assert not Played().run(0.25, 3, PUSH)


@pytest.mark.parametrize(("mute_s", "cycle_s"), [(0.6, 0.7), (0.0, 0.2)])
def test_a_contact_is_left_in_cycles_of_move_settle_and_measure(mute_s, cycle_s):
    played = Played(mute_s)
    played.run(0.5)
    sent = played.run(3.0, 3, PUSH)
    yaw = [command[3] for _, command in sent]
    assert (np.diff([0.0, *yaw]) > 0.0).all()
    periods = np.diff([when for when, _ in sent])
    assert np.min(periods) == pytest.approx(cycle_s, abs=0.03)
    assert played.verdict()[0] is Level.OK
    assert played.run(3.0)[-1][1][3] < yaw[-1]  # free: home


def test_a_contact_is_yielded_to_by_little_until_it_is_seen_in_a_second_pose():
    played = Played()
    played.run(0.5)
    played.run(1.2, 3, 3.0 * PUSH)
    assert played.turned_deg() == pytest.approx(0.45)
    assert "not confirmed" in played.verdict()[1]
    played.run(2.0, 3, 3.0 * PUSH)
    assert played.turned_deg() > 1.0


@pytest.mark.parametrize("state", [s for s in ForceState if s not in FORCE_KNOWN])
def test_a_force_that_stays_unknown_stops_it_unless_that_is_expected(state):
    played = Played()
    played.run(0.5)
    sent = len(played.run(0.6, 3, PUSH))
    played.run(0.7, state=ForceState.MOVING)
    played.run(1.0, state=state)
    assert len(played.sent) == sent
    expected = state in (ForceState.MOVING, ForceState.HIDDEN, ForceState.MOMENT)
    seen = ContactState.UNKNOWN if expected else ContactState.STOPPED
    assert played.controller.watch.state is seen
    if not expected:
        level, message = played.verdict()
        assert level is Level.ERROR
        assert state.value in message


def test_old_stamps_silence_and_refused_messages_stop_it_until_estimates_are_back():
    played = Played()
    watch = played.controller.watch
    played.run(0.5)
    assert not played.run(0.4, 3, PUSH, age_s=0.3)
    assert "no state of the force with a fresh stamp" in played.verdict()[1]
    played.run(0.2)
    assert watch.state is ContactState.STOPPED
    played.run(0.3)
    assert watch.state is ContactState.FREE
    assert watch.update(played.now_s + 0.19) is ContactState.FREE
    assert watch.update(played.now_s + 0.21) is ContactState.STOPPED
    played.run(0.5)
    watch.refused("a wrench was refused: nan")
    assert watch.update(played.now_s) is ContactState.STOPPED
    assert "nan" in watch.reason


def test_another_nodes_command_becomes_home_and_silences_it_and_its_own_do_not():
    played = Played(yield_s=1.0)
    played.run(0.5)
    elsewhere = np.full(8, 0.02)
    assert played.controller.received_command(elsewhere, played.now_s)
    assert not played.run(0.95, 3, PUSH)
    assert "another node commands" in played.verdict()[1]
    played.run(1.0, 3, PUSH)
    assert played.turned_deg(elsewhere) < 1.01
    assert np.array_equal(played.controller.home_rad, elsewhere)
    for _, command in played.sent:
        assert not played.controller.received_command(command, played.now_s)


def test_it_stays_within_its_reach_and_takes_no_step_from_beyond():
    played = Played(joint_limit_deg=2.0, step_limit_deg=6.0, speed_limit_deg_s=60.0, yield_s=0.0)
    played.run(0.5)
    played.run(30.0, 1, 50.0 * PUSH)
    last = played.sent[-1][1]
    assert np.hypot(last[0], last[1]) == pytest.approx(np.deg2rad(2.0))
    assert "joint_limit_deg" in played.verdict()[1]
    sent = len(played.sent)
    played.controller.received_command(np.full(8, 0.2), played.now_s)
    played.run(2.0, 3, PUSH)
    assert len(played.sent) == sent
    assert "beyond joint_limit_deg" in played.verdict()[1]


def test_it_waits_for_a_first_command_when_asked_to():
    played = Played(await_command=True)
    assert not played.run(2.0, 3, PUSH)
    assert "first command" in played.verdict()[1]
    played.controller.received_command(np.zeros(8), played.now_s)
    assert played.run(1.0, 3, PUSH)
