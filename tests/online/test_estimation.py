"""From samples to contacts: a force only from samples that can be trusted, and its bounds."""

import math
from contextlib import suppress

import numpy as np
import pytest
from joint_commands import joint_command
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
from cablesense_msgs_py.messages import NO_CONTACT, Contact, ForceState, Load
from cablesense_online.answer import decide
from cablesense_online.estimation import Estimation
from cablesense_online.models import load_model
from cablesense_online.samples import ProblemKind, SampleError
from cablesense_online.simulated_arm import SimulatedArm
from cablesense_online.state import EventKind
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.dynamics import ArmDynamics
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.kinematics import segment_rotations

pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark


def test_a_push_after_the_tare_is_a_contact_whatever_the_order_of_the_cables():
    feed = Feed()
    assert feed.sample(PUSHED).force is ForceState.UNTARED
    assert not feed.estimator.asked
    feed = Feed().tared()
    assert feed.sample().force is ForceState.FREE
    for order in (1, -1):
        contact = feed.sample(PUSHED[::order], ARM.cable_names[::order]).contact
        assert (contact.segment, contact.angle_deg, contact.magnitude_n) == (3, 70.0, 40.0)
        assert contact.contact_m == MECHANISM.contact_m[2]
        difference, command = feed.estimator.asked[-1]
        np.testing.assert_allclose(difference, PUSHED - UNLOADED, atol=1e-9)
        np.testing.assert_array_equal(command, np.zeros(8))


def spoiled(value):
    return [*PUSHED[:4], value, *PUSHED[5:]]


@pytest.mark.parametrize(
    ("sample", "kind"),
    [
        ({"tensions": spoiled(math.nan)}, ProblemKind.NOT_FINITE),
        ({"tensions": spoiled(1e6)}, ProblemKind.IMPLAUSIBLE),
        ({"tensions": PUSHED[:9], "names": ARM.cable_names[:9]}, ProblemKind.NAMES),
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


class Beside:
    """An estimation beside a simulated arm, at 100 Hz in simulated time."""

    def __init__(self, model="", **parameters):
        loaded = load_model("cdsm", model)
        settings = {"joint_speed_rad_s": math.radians(20.0), **parameters}
        self.estimation = Estimation(
            loaded.arm, loaded.estimator, SETTINGS.model_copy(update=settings), 0.0
        )
        self.arm = SimulatedArm(ArmDynamics(ARM), 1e-3, math.radians(20.0), 0.0, now_s=0.0)
        self.tick = 0

    @property
    def now_s(self):
        return 0.01 * self.tick

    def go_to(self, angles_rad):
        self.arm.go_to(angles_rad)
        self.estimation.command(joint_command(ARM, angles_rad))

    def push(self, segment, force_n):
        self.arm.push(Load(segment, np.array(force_n)), self.now_s)

    def sample(self):
        self.tick += 1
        self.arm.advance_to(self.now_s)
        now_ns = 10**18 + self.tick * 10_000_000
        raw = message_bytes(self.arm.reading_n(ARM.sensors, None), now_ns)
        return self.estimation.sample(raw, now_ns, self.now_s)


@pytest.mark.slow
def test_a_push_is_stated_while_all_joints_turn_slowly():
    """The misfit that the motion makes withholds no force, and intervals allow for damping."""
    limits = {"still_rad": np.deg2rad(0.02), "follow_rad_s": np.deg2rad(4.0)}
    beside, forces, covered = Beside(largest_misfit=2.3, **limits), [], []
    mechanism, angles = mechanism_of(open_arm("cdsm")), np.zeros(8)
    for tick in range(1, 401):
        if tick == 50:
            beside.push(3, [0.0, 20.0, 0.0])
        if 100 < tick <= 300 and tick % 2 == 0:  # 0.05 rad/s
            angles = 5e-4 * (tick - 100) * np.array([1, -1, -1, 1, 1, 1, -1, -1])
            beside.go_to(angles)
        answer = beside.sample()
        if tick > 100:
            forces.append(answer.force)
            assert answer.contact.segment in (0, 3)
        if tick > 100 and answer.contact.segment:
            axis = segment_rotations(mechanism, angles)[2][:, 0]
            normal_n = np.linalg.norm(np.cross(axis, [0.0, 20.0, 0.0]))
            covered.append(answer.estimate.low_n <= normal_n <= answer.estimate.high_n)
    assert np.mean([force is ForceState.MOVING for force in forces]) < 0.05
    assert forces[-1] is ForceState.CONTACT
    assert np.mean(covered) > 0.93


def test_the_tare_arrives_where_a_fast_trajectory_ends_slowly():
    """Its last commands are followed, as slow ones are, while the arm still counts as moving."""
    beside = Beside(still_rad=np.deg2rad(0.02), follow_rad_s=np.deg2rad(4.0), tare_samples=10)
    share = np.minimum(np.arange(1, 301) / 200.0, 1.0)
    for turn_rad in 0.2 * share**3 * (10.0 - 15.0 * share + 6.0 * share**2):
        beside.go_to(np.full(8, turn_rad))
        beside.sample()
    tares, unloaded = beside.estimation.tares, beside.estimation.plausibility.arm
    expected_n = tares.present.unloaded_n(unloaded.predict_n(np.full(8, 0.2)))
    np.testing.assert_allclose(tares.unloaded_n, expected_n, atol=1e-3)


def test_commands_with_the_noise_of_an_encoder_leave_an_arm_at_rest_its_estimate():
    beside, answers = Beside(still_rad=3e-4, follow_rad_s=0.07, tare_samples=10), []
    rng = np.random.default_rng(5)
    for tick in range(300):
        if tick == 50:
            beside.push(3, [0.0, 30.0, 0.0])
        if tick > 100:
            beside.estimation.command(joint_command(ARM, rng.normal(0.0, 1e-3, 8)))
            answers.append(beside.sample())
        else:
            beside.sample()
    off_n = [answer.contact.magnitude_n - 30.0 for answer in answers]
    width_n = [answer.estimate.high_n - answer.estimate.low_n for answer in answers]
    assert np.percentile(np.abs(off_n), 95.0) < 0.3
    assert np.percentile(width_n, 90.0) < 0.5


@pytest.mark.slow
def test_a_push_is_estimated_in_motion():
    """By a model with memory, while the arm goes to and fro."""
    beside, contacts = Beside("cdsm_moving", tare_samples=50), []
    away = np.deg2rad([6.0, -4.0, 5.0, 3.0, -6.0, 4.0, -3.0, 5.0])
    for tick in range(1, 501):
        if tick == 150:
            beside.push(4, [0.0, 0.0, -25.0])
        if tick >= 200 and tick % 100 == 0:
            beside.go_to(away if tick % 200 == 0 else np.zeros(8))
        answer = beside.sample()
        if tick >= 200:
            contacts.append(answer.contact)
    assert np.mean([contact.segment == 4 for contact in contacts]) > 0.95
    strength = np.array([contact.magnitude_n for contact in contacts])
    # gravity's direction turns against the segment's normal plane by up to 20 degrees
    assert np.quantile(strength, 0.05) > 21.0
    assert np.quantile(strength, 0.95) < 27.0


def test_the_bounds_hold_magnitude_and_direction_of_the_estimate():
    feed = Feed().tared()
    answer = feed.sample(PUSHED)
    contact, (lower, upper) = answer.contact, answer.bounds
    assert lower.segment == upper.segment == contact.segment == 3
    assert lower.magnitude_n < contact.magnitude_n < upper.magnitude_n
    assert upper.magnitude_n - lower.magnitude_n == pytest.approx(4 * 0.1, rel=0.03)
    assert upper.angle_deg - lower.angle_deg == pytest.approx(4 * 5.0, rel=0.03)


def test_a_force_that_may_act_unseen_makes_the_state_hidden():
    unsure = Feed(AnyDifference(std_n=3.0)).tared()
    answer = unsure.sample()
    assert (answer.contact, answer.force) == (NO_CONTACT, ForceState.HIDDEN)
    lower, upper = answer.bounds
    assert (lower, round(upper.magnitude_n)) == (NO_CONTACT, 6)
    tolerant = Feed(AnyDifference(std_n=3.0), hidden_above_n=7.0).tared()
    assert tolerant.sample().force is ForceState.FREE


def test_a_parameter_decides_what_an_unknown_force_is_published_as():
    feed = Feed().tared()
    known = [feed.sample(), feed.sample(PUSHED)]
    unknown = feed.sample([math.nan, *PUSHED[1:]])
    for answer in known:
        assert answer.wrench("nan") == answer.wrench("none") == answer.contact.wrench
    assert unknown.wrench("zero") == NO_CONTACT.wrench
    assert np.isnan(unknown.wrench("nan")).all()
    assert unknown.wrench("none") is None


CONTACT_M = (0.05, 0.06, 0.07, 0.08)


def decided(probabilities, angle_deg=0.0, magnitude_n=5.0, threshold=0.5):
    return decide(probabilities, angle_deg, magnitude_n, threshold, CONTACT_M)


def test_the_likeliest_segment_is_touched_where_any_contact_reaches_the_threshold():
    assert decided([0.1, 0.2, 0.1, 0.55, 0.05], 70.0, 40.0) == Contact(3, 70.0, 40.0, 0.07)
    assert decided([0.4, 0.15, 0.15, 0.1, 0.2]).segment == 4
    assert decided([0.25, 0.75, 0.0, 0.0, 0.0], threshold=0.75).segment == 1
    assert decided([0.25, 0.75, 0.0, 0.0, 0.0], threshold=0.8) == NO_CONTACT
    assert decided([0.0, 1.0, 0.0, 0.0, 0.0], 10.0, -3.0) == NO_CONTACT  # it does not push


@pytest.mark.parametrize(
    "estimate",
    [
        ([1.0, math.nan, 0.0, 0.0, 0.0], 10.0, 0.0),
        ([1.0, 0.0, 0.0, 0.0, 0.0], math.inf, 0.0),
        ([1.0, 0.0, 0.0, 0.0, 0.0], 10.0, -math.inf),
    ],
)
def test_a_number_that_is_not_finite_is_refused_also_where_nothing_touches(estimate):
    with pytest.raises(SampleError) as caught:
        decided(*estimate)
    assert caught.value.kind is ProblemKind.ESTIMATE
