"""From serialized samples to contacts: a force only from samples that can be trusted.

States and samples alone give the answers again: whatever happened when, from any state on.
"""

import math
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_base.errors import CableSenseError
from cablesense_msgs_py.messages import NO_CONTACT, Load
from cablesense_msgs_py.topics import ContractError
from cablesense_online.estimation import Estimation
from cablesense_online.models import load_model
from cablesense_online.samples import ProblemKind, SampleError
from cablesense_online.simulated_arm import SimulatedArm
from cablesense_online.state import EstimationSettings, Event, EventKind
from cablesense_online.tare import UnloadedTensions
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.dynamics import ArmDynamics
from cablesense_sim.equilibrium import solve_equilibrium

serialization = pytest.importorskip("rclpy.serialization")
sensor_msgs = pytest.importorskip("sensor_msgs.msg")
pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark

ARM = open_arm("cdsm")
MECHANISM = mechanism_of(ARM)
UNLOADED = solve_equilibrium(MECHANISM, np.zeros(8)).tensions_n
PUSHED = UNLOADED + np.linspace(-5.0, 5.0, 12)
SETTINGS = EstimationSettings(
    contact_threshold=0.5,
    stale_after_s=0.2,
    slack_below_n=1.0,
    tare_samples=5,
    tare_steady_n=1.0,
    auto_tare=True,
    joint_speed_rad_s=0.35,
    settle_s=0.5,
)


class AnyDifference:
    """A stand-in that finds a contact on segment 3 in any difference from the unloaded state."""

    pose_aware = True

    def __init__(self, probability=0.9, magnitude_n=40.0):
        self.probability, self.magnitude_n = probability, magnitude_n
        self.asked = []

    def estimate(self, tension_difference_n, joint_command_rad):
        self.asked.append((tension_difference_n, joint_command_rad))
        touched = self.probability if np.abs(tension_difference_n).max() > 1.0 else 0.0
        return SimpleNamespace(
            probabilities=np.array([1.0 - touched, 0.0, 0.0, touched, 0.0]),
            angle_deg=70.0,
            magnitude_n=self.magnitude_n,
        )


def message_bytes(tensions, stamp_ns, names=ARM.cable_names):
    message = sensor_msgs.JointState(name=list(names), effort=list(map(float, tensions)))
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    return serialization.serialize_message(message)


class Feed:
    """Samples one after the other, 10 ms apart."""

    def __init__(self, estimator=None, **changes):
        self.estimator = estimator or AnyDifference()
        self.estimation = Estimation(ARM, self.estimator, SETTINGS.model_copy(update=changes), 0.0)
        self.now_ns, self.stepped_ns = 10**18, 0

    @property
    def now_s(self):
        return (self.now_ns - self.stepped_ns - 10**18) * 1e-9

    def sample(self, tensions=UNLOADED, names=ARM.cable_names, age_ns=0, raw=None, step_ns=0):
        self.now_ns += 10_000_000 + step_ns
        self.stepped_ns += step_ns
        if raw is None:
            raw = message_bytes(tensions, self.now_ns - age_ns, names)
        return self.estimation.sample(raw, self.now_ns, self.now_s)

    def tared(self):
        for _ in range(SETTINGS.tare_samples):
            answer = self.sample()
        assert answer.new_tare is not None
        return self

    def command(self, angles_rad):
        self.estimation.command(SimpleNamespace(name=ARM.joint_names, position=angles_rad))


def test_a_push_after_the_tare_is_a_contact():
    feed = Feed().tared()
    assert feed.sample().contact == NO_CONTACT
    contact = feed.sample(PUSHED).contact
    assert (contact.segment, contact.angle_deg, contact.magnitude_n) == (3, 70.0, 40.0)
    assert contact.contact_m == MECHANISM.contact_m[2]
    difference, command = feed.estimator.asked[-1]
    np.testing.assert_allclose(difference, PUSHED - UNLOADED, atol=1e-9)
    np.testing.assert_array_equal(command, np.zeros(8))


def test_cables_are_identified_by_name_not_by_place():
    feed = Feed().tared()
    feed.sample(PUSHED[::-1], ARM.cable_names[::-1])
    np.testing.assert_allclose(feed.estimator.asked[-1][0], PUSHED - UNLOADED, atol=1e-9)


def test_no_force_before_a_tare():
    feed = Feed(auto_tare=False)
    for _ in range(20):
        assert feed.sample(PUSHED).contact == NO_CONTACT
    assert not feed.estimator.asked


def test_the_threshold_decides():
    feed = Feed(AnyDifference(probability=0.6)).tared()
    assert feed.sample(PUSHED).contact.segment == 3
    feed.estimation.adjust(contact_threshold=0.7, stale_after_s=0.2, slack_below_n=1.0)
    assert feed.sample(PUSHED).contact == NO_CONTACT


def spoiled(value):
    return [*PUSHED[:4], value, *PUSHED[5:]]


@pytest.mark.parametrize(
    ("sample", "kind"),
    [
        ({"tensions": spoiled(math.nan)}, ProblemKind.NOT_FINITE),
        ({"tensions": spoiled(math.inf)}, ProblemKind.NOT_FINITE),
        ({"tensions": spoiled(1e6)}, ProblemKind.IMPLAUSIBLE),
        ({"tensions": PUSHED[:-1]}, ProblemKind.NAMES),
        ({"tensions": []}, ProblemKind.NAMES),
        ({"tensions": PUSHED[:9], "names": ARM.cable_names[:9]}, ProblemKind.NAMES),
        ({"tensions": PUSHED, "names": ["cable_1"] * 12}, ProblemKind.NAMES),
        ({"tensions": PUSHED, "names": [f"rope_{i}" for i in range(12)]}, ProblemKind.NAMES),
        ({"tensions": PUSHED, "age_ns": 300_000_000}, ProblemKind.CLOCK),
        ({"tensions": PUSHED, "age_ns": -300_000_000}, ProblemKind.CLOCK),
        ({"raw": b""}, ProblemKind.MALFORMED),
        ({"raw": b"\0\1\0\0" + b"\xff" * 60}, ProblemKind.MALFORMED),
    ],
)
def test_a_bad_sample_gives_no_force_and_the_next_good_one_does(sample, kind):
    feed = Feed().tared()
    answer = feed.sample(**sample)
    assert answer.contact == NO_CONTACT
    assert answer.problem is not None
    assert answer.problem.kind is kind
    assert feed.sample(PUSHED).contact.segment == 3


def test_saturated_sensors_give_no_force():
    sensors = ARM.sensors.model_copy(update={"range_n": (0.0, 200.0)})
    feed = Feed()
    arm = ARM.model_copy(update={"sensors": sensors})
    feed.estimation = Estimation(arm, feed.estimator, SETTINGS, 0.0)
    feed.tared()
    answer = feed.sample(spoiled(200.0))
    assert answer.problem is not None
    assert answer.problem.kind is ProblemKind.SATURATED


def test_slack_cables_are_noted_and_estimated_with():
    feed = Feed().tared()
    assert feed.sample(spoiled(0.0)).contact.segment == 3
    assert feed.estimation.check.slack == (5,)


@pytest.mark.slow
@given(st.binary(max_size=300))
def test_no_bytes_bring_it_down(raw):
    assert Feed().sample(raw=raw).contact == NO_CONTACT


@pytest.mark.parametrize("magnitude", [math.nan, math.inf])
def test_an_estimate_that_is_not_finite_is_none(magnitude):
    answer = Feed(AnyDifference(magnitude_n=magnitude)).tared().sample(PUSHED)
    assert answer.contact == NO_CONTACT


def test_no_force_while_the_arm_moves_then_the_unloaded_state_of_the_new_pose():
    feed = Feed().tared()
    command = np.full(8, 0.05)
    feed.command(command)
    there = solve_equilibrium(MECHANISM, command).tensions_n
    assert np.abs(there - UNLOADED).max() > 1.0
    contacts = [feed.sample(there).contact for _ in range(200)]
    assert set(contacts) == {NO_CONTACT}
    assert feed.estimator.asked
    np.testing.assert_allclose(feed.estimator.asked[-1][0], 0.0, atol=1e-9)
    np.testing.assert_array_equal(feed.estimator.asked[-1][1], command)


def test_a_clock_that_steps_forward_in_mid_move_gives_no_force():
    feed = Feed().tared()
    feed.command(np.full(8, 0.05))
    feed.sample(PUSHED)
    state = None
    for _ in range(10):
        answer = feed.sample(PUSHED, step_ns=3600 * 10**9 if state is None else 0)
        state = answer.state or state
        assert answer.contact == NO_CONTACT
    assert [event.kind for event in state.events] == [EventKind.CLOCK_AHEAD]
    for _ in range(200):
        answer = feed.sample(PUSHED)
    assert answer.contact.segment == 3


def test_of_two_publishers_one_is_used_until_it_is_silent():
    feed = Feed().tared()
    feed.estimation.publisher.matched(2)
    for number in range(9000, 9100):
        assert feed.estimation.follow(number, feed.now_s) is (number == 9000)
        feed.sample()
        with pytest.raises(SampleError, match="its publisher's number") as refused:
            feed.estimation.follow(number - 8990, feed.now_s)
        assert refused.value.kind is ProblemKind.PUBLISHER
    assert feed.sample(PUSHED).contact.segment == 3
    silent_since_s, number = feed.now_s, 111
    while not followed(feed, number):
        feed.now_ns += 10_000_000
        number += 1
    assert feed.now_s - silent_since_s == pytest.approx(SETTINGS.stale_after_s, abs=0.02)
    began = feed.sample(PUSHED)
    assert [event.kind for event in began.state.events] == [EventKind.PUBLISHER]
    waited = [feed.sample(PUSHED).contact.segment for _ in range(70)]
    assert waited == [0] * 59 + [3] * 11  # 0.1 s for the shortest move, 0.5 s to settle


def followed(feed, number):
    with suppress(SampleError):
        return feed.estimation.follow(number, feed.now_s)
    return False


def test_a_refused_command_leaves_the_one_before():
    feed = Feed().tared()
    for angles in (np.full(8, math.nan), np.full(8, 1.04), np.zeros(7)):
        with pytest.raises(CableSenseError):
            feed.command(angles)
    assert feed.sample(PUSHED).contact.segment == 3


def test_silence_becomes_stale():
    feed = Feed().tared()
    assert not feed.estimation.stale(feed.now_s + 0.19)
    assert feed.estimation.stale(feed.now_s + 0.21)


BENT = np.deg2rad([0.0, 0.0, 8.0, 0.0, 6.0, 0.0, 0.0, 0.0])


def judged(**changes):
    """An estimator with the arm's own model that judges its tares, as the node does."""
    return Feed(load_model("cdsm", "").estimator, tare_deviation_n=2.0, **changes)


def fed(feed, tensions, count=20):
    return [feed.sample(tensions) for _ in range(count)]


def test_beside_a_bent_arm_no_tare_is_taken_before_a_command():
    """Taken for straight it gives a force for good after the next command."""
    feed = judged()
    there = solve_equilibrium(MECHANISM, BENT).tensions_n
    assert all(answer.new_tare is None for answer in fed(feed, there))
    assert "auto_tare waits: cable_" in feed.estimation.tares.status().message
    with pytest.raises(CableSenseError, match=r"cable_\d+ lies [+-]\d+\.\d N"):
        feed.estimation.take_tare(feed.now_ns)
    feed.command(BENT)
    assert sum(answer.new_tare is not None for answer in fed(feed, there, 300)) == 1
    feed.command(np.zeros(8))
    assert {answer.contact for answer in fed(feed, UNLOADED, 300)} == {NO_CONTACT}


def test_a_load_of_35_n_is_not_tared_by_itself():
    feed, force = judged(), np.zeros((4, 3))
    force[2, 1] = 35.0
    loaded = solve_equilibrium(MECHANISM, np.zeros(8), force).tensions_n
    assert all(answer.new_tare is None for answer in fed(feed, loaded))
    assert sum(answer.new_tare is not None for answer in fed(feed, UNLOADED)) == 1
    assert {answer.contact for answer in fed(feed, UNLOADED)} == {NO_CONTACT}
    assert fed(feed, loaded)[-1].contact.magnitude_n == pytest.approx(35.0, abs=1.0)


def test_no_tare_is_taken_in_a_contact_that_is_reported():
    feed = Feed().tared()
    fed(feed, PUSHED)
    with pytest.raises(CableSenseError, match=r"contact of 40\.0 N on segment 3"):
        feed.estimation.take_tare(feed.now_ns)
    assert feed.sample(PUSHED).contact.segment == 3
    feed.estimation.take_tare(feed.now_ns, forced=True)
    assert feed.sample(PUSHED).contact == NO_CONTACT


def test_the_automatic_tare_of_an_assumed_pose_is_dropped_and_taken_anew():
    feed = judged().tared()
    there = solve_equilibrium(MECHANISM, BENT).tensions_n
    feed.command(BENT)
    assert feed.sample(there).state.tared_n == ()
    fed(feed, there, 300)
    tare = feed.estimation.tares.present
    np.testing.assert_array_equal(tare.command_rad, BENT)
    feed.command(np.zeros(8))
    assert feed.estimation.tares.present is tare


class EveryBit:
    """An answer in which every bit of the difference and of the command shows."""

    pose_aware = True

    def estimate(self, tension_difference_n, joint_command_rad):
        weights = np.arange(1.0, 13.0)
        return SimpleNamespace(
            probabilities=np.array([0.25, 0.0, 0.75, 0.0, 0.0]),
            angle_deg=float(weights[:8] @ joint_command_rad),
            magnitude_n=100.0 + float(weights @ tension_difference_n),
        )


def every_bit():
    return Feed(EveryBit(), tare_samples=4, settle_s=0.05)


def live_run(seed, count=120):
    """Samples in order with their answers, while commands and tares come between them."""
    rng = np.random.default_rng(seed)
    feed, run = every_bit(), []
    live, stamp = feed.estimation, 10**18
    for step in range(count):
        chance = rng.random()
        if chance < 0.05:
            feed.command(rng.uniform(-0.004, 0.004, 8))
        elif chance < 0.15:
            with suppress(CableSenseError):
                live.take_tare(stamp, forced=True) if chance < 0.12 else live.undo_tare()
        elif chance < 0.17:
            live.adjust(float(rng.uniform(0.0, 1.0)), 0.2, 1.0)
        elif chance < 0.18:
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
@settings(max_examples=8, deadline=None)
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
        assert again[:3] == answer[:3]


def test_a_state_comes_with_the_first_sample_after_a_change():
    feed, events = every_bit(), []
    feed.estimation.start(0.0)  # again, before the first sample
    for i in range(12):
        if i == 8:
            feed.estimation.take_tare(feed.now_ns, forced=True)
            feed.estimation.undo_tare()
        if i == 10:
            for angle in (0.001, 0.002, 0.002):
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
        (10, [Event(EventKind.COMMAND, (angle,) * 8) for angle in (0.001, 0.002)]),
        (11, [Event(EventKind.SETTINGS)]),
    ]
    assert state.settings.contact_threshold == 0.7
    assert state.origin["joints"].split() == list(ARM.joint_names)
    assert feed.estimation.gate.rest_from_ns > feed.now_ns


def test_a_state_has_the_tare_once_there_is_one():
    feed = Feed()
    first = feed.sample().state
    assert (first.unloaded_n, first.tared_n, first.tare_command_rad) == ((), (), ())
    for _ in range(SETTINGS.tare_samples):
        state = feed.sample().state
    np.testing.assert_allclose(state.tared_n, UNLOADED)
    assert state.tared_n == state.unloaded_n
    assert state.tare_command_rad == (0.0,) * 8


def test_a_sample_refused_for_its_content_is_answered_with_its_stamp():
    feed = Feed()
    answer = feed.sample(np.full(12, np.nan))
    assert answer.problem is not None
    assert answer.stamp_ns == feed.now_ns
    refused = feed.sample(age_ns=20_000_000)
    assert refused.problem is not None
    assert refused.stamp_ns == 0


def test_another_arm_carries_the_tare_over_by_its_own_model():
    feed = every_bit()
    for _ in range(5):
        state = feed.sample(np.full(12, 100.0)).state
    moved = state.model_copy(update={"command_rad": (0.01,) * 8})
    same, other = every_bit().estimation, every_bit().estimation
    same.restore(moved)
    other.restore(moved.model_copy(update={"arm": "another"}))
    np.testing.assert_array_equal(same.tares.unloaded_n, state.unloaded_n)
    gone = other.tares.unloaded_n - np.array(state.tared_n)
    predict_n = UnloadedTensions(ARM).predict_n
    np.testing.assert_allclose(
        gone, predict_n(np.full(8, 0.01)) - predict_n(np.zeros(8)), atol=1e-9
    )


def test_a_state_of_an_arm_with_other_joints_is_refused():
    feed = Feed()
    state = feed.sample().state
    with pytest.raises(ContractError, match="7 joint angles"):
        feed.estimation.restore(state.model_copy(update={"command_rad": (0.0,) * 7}))


AWAY = np.deg2rad([6.0, -4.0, 5.0, 3.0, -6.0, 4.0, -3.0, 5.0])


def contacts_in_motion(push_n=None):
    """What `cdsm_moving` gives for each sample of 4 s to and fro, in simulated time at 100 Hz."""
    loaded = load_model("cdsm", "cdsm_moving")
    parameters = {"joint_speed_rad_s": math.radians(20.0), "tare_samples": 50}
    estimation = Estimation(
        loaded.arm, loaded.estimator, SETTINGS.model_copy(update=parameters), 0.0
    )
    arm = SimulatedArm(ArmDynamics(ARM), 1e-3, parameters["joint_speed_rad_s"], 0.0, now_s=0.0)
    contacts = []
    for tick in range(1, 601):
        now_s, now_ns = tick * 0.01, 10**18 + tick * 10_000_000
        if tick == 150 and push_n is not None:
            arm.push(Load(4, np.array(push_n)), now_s)
        if tick >= 200 and tick % 100 == 0:
            target = AWAY if tick % 200 == 0 else np.zeros(8)
            arm.go_to(target)
            command = sensor_msgs.JointState(name=list(ARM.joint_names), position=target.tolist())
            estimation.command(command)
        arm.advance_to(now_s)
        answer = estimation.sample(
            message_bytes(arm.reading_n(ARM.sensors, None), now_ns), now_ns, now_s
        )
        if tick >= 200:
            contacts.append(answer.contact)
    assert estimation.tares.present is not None
    return contacts


@pytest.mark.slow
def test_a_free_arm_in_motion_has_no_contact():
    strength = np.array([contact.magnitude_n for contact in contacts_in_motion()])
    assert np.mean(strength == 0.0) > 0.9
    assert np.mean(strength) < 0.1


@pytest.mark.slow
def test_a_push_is_estimated_in_motion():
    contacts = contacts_in_motion((0.0, 0.0, -25.0))
    assert np.mean([contact.segment == 4 for contact in contacts]) > 0.95
    strength = np.array([contact.magnitude_n for contact in contacts])
    # gravity's direction turns against the segment's normal plane by up to 20 degrees
    assert np.quantile(strength, 0.05) > 21.0
    assert np.quantile(strength, 0.95) < 27.0
