"""From serialized samples to contacts: a force only from samples that can be trusted."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_base.errors import CableSenseError
from cablesense_msgs_py.wrenches import NO_CONTACT
from cablesense_online.estimation import Estimation
from cablesense_online.journal import EstimationSettings
from cablesense_online.samples import ProblemKind
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
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


class Feed:
    """Samples one after the other, 10 ms apart."""

    def __init__(self, estimator=None, **changes):
        self.estimator = estimator or AnyDifference()
        self.estimation = Estimation(ARM, self.estimator, replace(SETTINGS, **changes), 0.0)
        self.now_ns = 10**18

    @property
    def now_s(self):
        return (self.now_ns - 10**18) * 1e-9

    def sample(self, tensions=UNLOADED, names=ARM.cable_names, age_ns=0, raw=None):
        self.now_ns += 10_000_000
        if raw is None:
            message = sensor_msgs.JointState(name=list(names), effort=list(map(float, tensions)))
            seconds, nanoseconds = divmod(self.now_ns - age_ns, 10**9)
            message.header.stamp.sec, message.header.stamp.nanosec = seconds, nanoseconds
            raw = serialization.serialize_message(message)
        return self.estimation.sample(raw, self.now_ns, self.now_s)

    def tared(self):
        for _ in range(SETTINGS.tare_samples):
            outcome = self.sample()
        assert outcome.new_tare is not None
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


def test_cables_are_told_by_name_not_by_place():
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
    outcome = feed.sample(**sample)
    assert outcome.contact == NO_CONTACT
    assert outcome.problem is not None
    assert outcome.problem.kind is kind
    assert feed.sample(PUSHED).contact.segment == 3


def test_saturated_sensors_give_no_force():
    sensors = ARM.sensors.model_copy(update={"range_n": (0.0, 200.0)})
    feed = Feed()
    arm = ARM.model_copy(update={"sensors": sensors})
    feed.estimation = Estimation(arm, feed.estimator, SETTINGS, 0.0)
    feed.tared()
    outcome = feed.sample(spoiled(200.0))
    assert outcome.problem is not None
    assert outcome.problem.kind is ProblemKind.SATURATED


def test_slack_cables_are_noted_and_estimated_with():
    feed = Feed().tared()
    assert feed.sample(spoiled(0.0)).contact.segment == 3
    assert feed.estimation.check.slack == (5,)


@given(st.binary(max_size=300))
def test_no_bytes_bring_it_down(raw):
    assert Feed().sample(raw=raw).contact == NO_CONTACT


@pytest.mark.parametrize("magnitude", [math.nan, math.inf])
def test_an_estimate_that_is_not_finite_is_none(magnitude):
    outcome = Feed(AnyDifference(magnitude_n=magnitude)).tared().sample(PUSHED)
    assert outcome.contact == NO_CONTACT


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
