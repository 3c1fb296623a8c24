"""From samples to contacts: a force only from samples that can be trusted, and its bounds."""

import math
from contextlib import suppress

import numpy as np
import pytest

from cablesense_base import CableSenseError
from cablesense_contact.felt_arm import FeltArm
from cablesense_msgs_py.messages import NO_CONTACT, Contact, ForceState, Load
from cablesense_online.answer import decide
from cablesense_online.calibrated_arm import CalibratedArm
from cablesense_online.contact_estimator import Sample
from cablesense_online.contacts import LawContacts
from cablesense_online.estimation import Estimation
from cablesense_online.models import load_model
from cablesense_online.samples import ProblemKind, SampleError
from cablesense_online.simulated_arm import SimulatedArm
from cablesense_online.tare import TareError
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.dynamics import ArmDynamics
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.kinematics import segment_rotations
from cablesense_sim.loads import normal_force_n
from tests.helpers.joint_commands import joint_command
from tests.helpers.sample_feed import (
    ARM,
    MECHANISM,
    PUSHED,
    SETTINGS,
    UNLOADED,
    AnyDifference,
    Feed,
    message_bytes,
)

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
    for angles in (np.full(8, math.nan), np.zeros(7)):
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
    silent_since_s = feed.now_s
    number = 111
    while not followed(feed, number):
        feed.now_ns += 10_000_000
        number += 1
    assert feed.now_s - silent_since_s == pytest.approx(SETTINGS.stale_after_s, abs=0.02)
    began = feed.sample(PUSHED)
    assert began.force is ForceState.MOVING
    waited = [feed.sample(PUSHED).contact.segment for _ in range(70)]
    assert waited == [0] * 59 + [3] * 11  # 0.1 s for the shortest move, 0.5 s to settle


def followed(feed, number):
    with suppress(SampleError):
        return feed.estimation.follow(number, feed.now_s)
    return False


BENT = np.deg2rad([0.0, 0.0, 8.0, 0.0, 6.0, 0.0, 0.0, 0.0])
LAB = open_arm("cdsm_lab")


def fed(feed, tensions, count=20):
    return [feed.sample(tensions) for _ in range(count)]


@pytest.fixture(scope="module")
def law():
    return load_model("cdsm", "").model


@pytest.fixture(scope="module")
def lab_law():
    return load_model("cdsm_lab", "").model


def known(law, arm=ARM, **changes):
    """An estimation that answers by the law of an arm."""
    settings = SETTINGS.model_copy(update=changes)
    calibrated = CalibratedArm(FeltArm(arm), law, settings)
    return LawContacts(FeltArm(arm), law, calibrated, 0.5, settings.hidden_above_n)


def test_beside_a_bent_arm_no_tare_is_taken_before_a_command(law):
    """Taken for straight it gives a force for good after the next command."""
    feed = Feed(contacts=known(law))
    there = solve_equilibrium(MECHANISM, BENT).tensions_n
    assert all(answer.new_tare is None for answer in fed(feed, there))
    assert "not those of the untouched arm" in feed.estimation.state.tare_problem
    assert all(answer.force is ForceState.UNTARED for answer in fed(feed, there))
    feed.command(BENT)
    assert sum(answer.new_tare is not None for answer in fed(feed, there, 300)) == 1
    feed.command(np.zeros(8))
    assert {answer.contact for answer in fed(feed, UNLOADED, 300)} == {NO_CONTACT}


def test_a_tare_taken_by_itself_is_dropped_where_the_arm_was_not_as_assumed():
    feed = Feed().tared()
    assert feed.estimation.command(joint_command(ARM, BENT))
    assert not feed.estimation.state.unloaded.known
    assert feed.estimation.state.unloaded.automatic
    feed = Feed().tared()
    feed.command(np.zeros(8))
    assert not feed.estimation.command(joint_command(ARM, BENT))
    assert feed.estimation.state.unloaded.known


@pytest.mark.parametrize("by_law", [False, True])
def test_an_undone_tare_never_leaves_the_estimator_without_a_force(law, by_law):
    feed = Feed(contacts=known(law) if by_law else None).tared()
    (first,) = feed.estimation.state.unloaded.tares
    fed(feed, UNLOADED)
    for _ in range(3):
        in_force = feed.estimation.undo_tare(feed.now_ns)
        assert feed.estimation.state.unloaded.tares == (in_force,)
        assert in_force is not first
        assert {answer.force for answer in fed(feed, UNLOADED)} == {ForceState.FREE}
    swinging = UNLOADED + 20.0 * np.eye(12)[4]
    for _ in range(SETTINGS.tare_samples):
        fed(feed, swinging, 1)
        fed(feed, UNLOADED, 1)
    with pytest.raises(TareError, match=r"the only one, and is kept.* cable_5 varies"):
        feed.estimation.undo_tare(feed.now_ns)
    assert feed.estimation.state.unloaded.tares == (in_force,)
    assert fed(feed, UNLOADED)[-1].force is ForceState.FREE


def test_the_same_state_and_sample_give_the_same_answer_whatever_was_asked_between(law):
    feed = Feed(contacts=known(law)).tared()
    estimator = feed.estimation.estimator
    pushes = [PUSHED, UNLOADED, PUSHED + 3.0]
    samples = [
        Sample(message_bytes(tensions, now_ns), now_ns, 1.0)
        for tensions, now_ns in zip(pushes, range(feed.now_ns + 10**7, 2**62, 10**7), strict=False)
    ]
    for sample in samples:
        first, answer = estimator.answer(feed.estimation.state, sample)
        estimator.answer(first, samples[-1])
        second, again = estimator.answer(feed.estimation.state, sample)
        assert again.contacts == answer.contacts
        assert again.force is answer.force
        assert again.probabilities == answer.probabilities
        assert second.stamps == first.stamps


def test_samples_that_come_together_are_answered_as_one_by_one_in_fewer_questions(law):
    """Untouched, pushed, and with one in the middle that is refused."""
    asked = Counted(law)
    feed = Feed(contacts=known(asked)).tared()
    fed(feed, UNLOADED, 60)
    began = feed.estimation.state
    force_n = normal_force_n(MECHANISM, np.zeros(8), segment=3, angle_deg=70.0, magnitude_n=40.0)
    pushed = solve_equilibrium(MECHANISM, np.zeros(8), force_n).tensions_n
    pushes = [UNLOADED, UNLOADED, pushed, np.full(12, np.nan), pushed, pushed + 0.01]
    stamps_ns = feed.now_ns + 10**6 * np.arange(1, len(pushes) + 1)
    raws = [message_bytes(*sent) for sent in zip(pushes, stamps_ns.tolist(), strict=True)]
    now_ns = int(stamps_ns[-1])
    asked.calls = 0
    together = list(feed.estimation.samples(raws, now_ns, 1.0))
    calls_together = asked.calls
    state = feed.estimation.state
    feed.estimation.state = began
    asked.calls = 0
    in_turn = [feed.estimation.sample(raw, now_ns, 1.0) for raw in raws]
    assert calls_together < asked.calls
    assert {answer.force for answer in in_turn} == {
        ForceState.FREE,
        ForceState.UNCONFIRMED,  # it has just changed
        ForceState.REFUSED,
    }
    for one, other in zip(together, in_turn, strict=True):
        assert one.force is other.force
        np.testing.assert_allclose(one.probabilities, other.probabilities, atol=1e-9)
        for contact, same in zip(one.contacts, other.contacts, strict=True):
            np.testing.assert_allclose(contact, same, rtol=1e-9, atol=1e-12)
    assert state.stamps == feed.estimation.state.stamps


class Counted:
    """A law that counts how often it is asked, and takes as many readings at once as come."""

    most_together = 100

    def __init__(self, law):
        self.law = law
        self.calls = 0

    def __call__(self, *inputs):
        self.calls += 1
        return self.law(*inputs)


class Beside:
    """An estimation beside a simulated arm, at 100 Hz in simulated time."""

    def __init__(self, law, arm=LAB, **parameters):
        settings = {"joint_speed_rad_s": math.radians(20.0), **parameters}
        contacts = known(law, arm, **settings)
        self.file = arm
        self.estimation = Estimation(
            FeltArm(arm), contacts, SETTINGS.model_copy(update=settings), 0.0
        )
        self.arm = SimulatedArm(ArmDynamics(arm), 1e-3, math.radians(20.0), 0.0, now_s=0.0)
        self.tick = 0

    @property
    def now_s(self):
        return 0.01 * self.tick

    def go_to(self, angles_rad):
        self.arm.go_to(angles_rad)
        self.estimation.command(joint_command(self.file, angles_rad))

    def push(self, segment, force_n):
        self.arm.push(Load(segment, np.array(force_n)), self.now_s)

    def sample(self):
        self.tick += 1
        self.arm.advance_to(self.now_s)
        now_ns = 10**18 + self.tick * 10_000_000
        reading_n = self.arm.reading_n(self.file.sensors, None)
        raw = message_bytes(reading_n, now_ns, self.file.cable_names)
        return self.estimation.sample(raw, now_ns, self.now_s)


@pytest.mark.slow
def test_a_push_is_stated_while_all_joints_turn_slowly(lab_law):
    """What the motion adds withholds no force, and intervals allow for damping."""
    limits = {"still_rad": np.deg2rad(0.02), "follow_rad_s": np.deg2rad(4.0)}
    beside = Beside(lab_law, **limits)
    mechanism = mechanism_of(LAB)
    forces = []
    covered = []
    angles = np.zeros(8)
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


def test_a_push_is_unconfirmed_until_the_arm_cannot_swing_any_more(lab_law):
    beside = Beside(lab_law)
    for _ in range(60):
        beside.sample()
    beside.push(4, [0.0, 15.0, 0.0])
    states = [beside.sample().force for _ in range(100)]
    assert ForceState.UNCONFIRMED in states[:10]
    assert states[-1] is ForceState.CONTACT


def test_commands_with_the_noise_of_an_encoder_leave_an_arm_at_rest_its_estimate(lab_law):
    beside = Beside(lab_law, still_rad=3e-4, follow_rad_s=0.07, tare_samples=10)
    answers = []
    rng = np.random.default_rng(5)
    for tick in range(300):
        if tick == 50:
            beside.push(3, [0.0, 30.0, 0.0])
        if tick > 100:
            beside.estimation.command(joint_command(LAB, rng.normal(0.0, 1e-3, 8)))
            answers.append(beside.sample())
        else:
            beside.sample()
    contacts = [answer for answer in answers if answer.contact.magnitude_n]
    off_n = [answer.contact.magnitude_n - 30.0 for answer in contacts]
    assert len(contacts) > 0.9 * len(answers)
    assert np.percentile(np.abs(off_n), 95.0) < 1.5


def test_the_bounds_hold_magnitude_and_direction_of_the_estimate():
    feed = Feed().tared()
    answer = feed.sample(PUSHED)
    contact = answer.contact
    (lower, upper) = answer.bounds
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
