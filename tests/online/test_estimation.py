"""From serialized samples to contacts: a force only from samples that can be trusted."""

import math
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sample_feed import (
    ARM,
    MECHANISM,
    PUSHED,
    SETTINGS,
    UNLOADED,
    AnyDifference,
    Feed,
    message_bytes,
)

from cablesense_base import CableSenseError
from cablesense_msgs_py.messages import NO_CONTACT, ForceState, Load
from cablesense_online.estimation import Estimation
from cablesense_online.models import load_model
from cablesense_online.samples import ProblemKind, SampleError
from cablesense_online.simulated_arm import SimulatedArm
from cablesense_online.state import EventKind
from cablesense_sim.dynamics import ArmDynamics
from cablesense_sim.equilibrium import solve_equilibrium

sensor_msgs = pytest.importorskip("sensor_msgs.msg")
pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark


def test_a_push_after_the_tare_is_a_contact_whatever_the_order_of_the_cables():
    feed = Feed().tared()
    assert feed.sample().contact == NO_CONTACT
    for order in (1, -1):
        contact = feed.sample(PUSHED[::order], ARM.cable_names[::order]).contact
        assert (contact.segment, contact.angle_deg, contact.magnitude_n) == (3, 70.0, 40.0)
        assert contact.contact_m == MECHANISM.contact_m[2]
        difference, command = feed.estimator.asked[-1]
        np.testing.assert_allclose(difference, PUSHED - UNLOADED, atol=1e-9)
        np.testing.assert_array_equal(command, np.zeros(8))


def test_threshold_and_slack_cables_may_be_set_while_running():
    feed = Feed(AnyDifference(probability=0.6)).tared()
    assert feed.sample(spoiled(0.0)).contact.segment == 3
    assert feed.estimation.check.slack == (5,)
    feed.estimation.adjust(contact_threshold=0.7, stale_after_s=0.2, slack_below_n=-1.0)
    assert feed.sample(spoiled(0.0)).contact == NO_CONTACT
    assert feed.estimation.check.slack == ()


def test_no_force_before_a_tare():
    feed = Feed(auto_tare=False)
    for _ in range(20):
        assert feed.sample(PUSHED).contact == NO_CONTACT
    assert not feed.estimator.asked


def spoiled(value):
    return [*PUSHED[:4], value, *PUSHED[5:]]


@pytest.mark.parametrize(
    ("sample", "kind"),
    [
        ({"tensions": spoiled(math.nan)}, ProblemKind.NOT_FINITE),
        ({"tensions": spoiled(math.inf)}, ProblemKind.NOT_FINITE),
        ({"tensions": spoiled(1e6)}, ProblemKind.IMPLAUSIBLE),
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
    for angles in (np.full(8, math.nan), np.full(8, 1.04), np.zeros(7)):
        with pytest.raises(CableSenseError):  # a refused command leaves the one before
            feed.command(angles)
    answer = feed.sample(**sample)
    state = ForceState.STALE if kind is ProblemKind.CLOCK else ForceState.REFUSED
    assert (answer.contact, answer.force) == (NO_CONTACT, state)
    assert answer.stamp_ns in (0, feed.now_ns)
    assert answer.problem is not None
    assert answer.problem.kind is kind
    assert feed.sample(PUSHED).contact.segment == 3


@pytest.mark.slow
@given(st.binary(max_size=300))
def test_no_bytes_bring_it_down(raw):
    assert Feed().sample(raw=raw).contact == NO_CONTACT


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


def test_no_tare_is_taken_in_a_contact_that_is_reported():
    feed = Feed().tared()
    fed(feed, PUSHED)
    with pytest.raises(CableSenseError, match=r"contact of 40\.0 N on segment 3"):
        feed.estimation.take_tare(feed.now_ns)
    assert feed.sample(PUSHED).contact.segment == 3
    feed.estimation.take_tare(feed.now_ns, forced=True)
    assert feed.sample(PUSHED).contact == NO_CONTACT


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
@pytest.mark.parametrize(("amplitude_deg", "off_n"), [(2e-4, 0.3), (1.0, 0.5)])
def test_a_push_is_estimated_while_commands_stream_that_hardly_or_slowly_move(
    amplitude_deg, off_n
):
    loaded = load_model("cdsm", "")
    follow = {"still_rad": np.deg2rad(0.02), "follow_rad_s": np.deg2rad(4.0)}
    parameters = follow | {"joint_speed_rad_s": np.deg2rad(20.0)}
    estimation = Estimation(
        loaded.arm, loaded.estimator, SETTINGS.model_copy(update=parameters), 0.0
    )
    arm = SimulatedArm(ArmDynamics(ARM), 1e-3, parameters["joint_speed_rad_s"], 0.0, now_s=0.0)
    touched = []
    for tick in range(1, 301):
        now_s, now_ns = tick * 0.01, 10**18 + tick * 10_000_000
        angles = np.zeros(8)
        angles[2] = np.deg2rad(amplitude_deg) * np.sin(2.0 * max(0.0, now_s - 0.5))
        arm.go_to(angles)
        command = sensor_msgs.JointState(name=list(ARM.joint_names), position=angles.tolist())
        estimation.command(command)
        if tick == 100:
            arm.push(Load(3, np.array([0.0, 30.0, 0.0])), now_s)
        arm.advance_to(now_s)
        answer = estimation.sample(
            message_bytes(arm.reading_n(ARM.sensors, None), now_ns), now_ns, now_s
        )
        if tick >= 130:
            assert answer.force is ForceState.CONTACT
            touched.append(answer.contact)
    assert {contact.segment for contact in touched} == {3}
    assert max(abs(contact.magnitude_n - 30.0) for contact in touched) < off_n


@pytest.mark.slow
def test_a_push_is_estimated_in_motion():
    contacts = contacts_in_motion((0.0, 0.0, -25.0))
    assert np.mean([contact.segment == 4 for contact in contacts]) > 0.95
    strength = np.array([contact.magnitude_n for contact in contacts])
    # gravity's direction turns against the segment's normal plane by up to 20 degrees
    assert np.quantile(strength, 0.05) > 21.0
    assert np.quantile(strength, 0.95) < 27.0
