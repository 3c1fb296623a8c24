"""Breathing: its circle and set-points, its readings, and the estimation beside it."""

import math

import numpy as np
import pytest

from benchmarks.estimation_settings import estimation_settings
from cablesense_msgs_py.messages import BREATH_END, Level, Load
from cablesense_msgs_py.topics import ContractError
from cablesense_online.breath_readings import BreathState, Mark, after_reading
from cablesense_online.breathing import (
    MOST_RAD,
    SET_POINTS_A_TURN,
    Breath,
    BreathError,
    breath_circle,
    offsets_m,
)
from cablesense_online.estimation import BREATHER_SILENT_AFTER_S, Estimation
from cablesense_online.models import load_model
from cablesense_online.simulated_arm import SimulatedArm
from cablesense_online.statuses import breath_status
from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.dynamics import moving_arm
from tests.helpers.arm_variants import variant
from tests.helpers.joint_commands import cable_offsets, joint_command
from tests.helpers.sample_feed import ARM, PUSHED, Feed, message_bytes

pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark

STRAIGHT = np.zeros(8)
BENT = np.radians([4.0, -3.0, 6.0, 2.0, -5.0, 7.0, 3.0, -2.0])


def arm(coefficient=0.1, name="cdsm_lab", **changes):
    parameters = {"coefficient": coefficient, "pulley_wrap_rad": 1.57}
    effect = {"effect": "capstan_friction", "at": "arm", "parameters": parameters}
    return variant({"effects": [effect], **changes}, name)


def circle_of(arm_of, points):
    return np.array([arm_of.at(k / points) for k in range(points)])


@pytest.mark.parametrize("command", [STRAIGHT, BENT], ids=["straight", "bent"])
@pytest.mark.parametrize("count", [2, 3, 4])
def test_every_cable_moves_in_and_out_at_every_guide_it_passes(command, count):
    angles = {"first": 0, "per_segment": 120 / count, "per_cable": -120}
    some = arm(**{"segments.count": count, "cables.angle_deg": angles})
    mechanism = mechanism_of(some)
    command = np.resize(command, 2 * count)
    circle = breath_circle(some, command)
    beyond_m = [
        kinematics.spans(mechanism, command + deviation).length_m[..., ::-1].cumsum(-1)[..., ::-1]
        for deviation in circle_of(circle, 24)
    ]
    swing_m = np.ptp(beyond_m, axis=0)
    passed = mechanism.cable_segment[:, None] > np.arange(count)
    stretch_m = np.sinh(0.1 * 1.57) * mechanism.pretension_n / mechanism.stiffness_n_m
    assert (swing_m[passed].reshape(-1) > 2.0 * stretch_m.max()).all()


def test_set_points_begin_and_end_at_the_command_and_never_jump():
    circle = breath_circle(arm(), BENT)
    breath = Breath(circle, 2)
    points = [STRAIGHT]
    marks = []
    while not breath.over:
        point, turn = breath.next()
        points.append(point)
        marks.append(turn)
    assert marks.count(1) == SET_POINTS_A_TURN
    assert max(marks) == 2
    assert marks[-1] == BREATH_END
    np.testing.assert_array_equal(points[-1], STRAIGHT)
    steps = np.abs(np.diff(points, axis=0)).max()
    assert steps <= 1.1 * 2.0 * np.pi / SET_POINTS_A_TURN * circle.largest_rad
    whole = np.array(points[1:])[np.array(marks) == 1]
    half = SET_POINTS_A_TURN // 2
    np.testing.assert_allclose(whole[:half], -whole[half:], atol=1e-12)


def test_where_there_is_no_breath_the_reason_is_given():
    with pytest.raises(BreathError, match="lists no capstan_friction"):
        breath_circle(variant({}), STRAIGHT)
    given_circle = breath_circle(variant({}), STRAIGHT, amplitude_rad=0.004)
    assert given_circle.largest_rad == pytest.approx(0.004)
    with pytest.raises(BreathError, match=r"swing by .* degrees, more than 2"):
        breath_circle(arm(0.8), STRAIGHT)
    with pytest.raises(BreathError, match=r"more than 2"):
        breath_circle(arm(), STRAIGHT, amplitude_rad=1.1 * MOST_RAD)
    with pytest.raises(BreathError, match=r"cable_\d+ with .* slack"):
        breath_circle(arm(**{"cables.pretension_n": 5.0}), STRAIGHT)
    with pytest.raises(BreathError, match=r"tip by .* mm, more than 0.01"):
        breath_circle(arm(), BENT, largest_tip_m=1e-5)


TRUE_N = np.array([0.0, *np.linspace(20.0, 120.0, 11)])  # one cable is slack
GRIP = 0.16
MS = 1_000_000


class StickingCables:
    """Cables that slide in and out, one after the other; readings are off by exp(± grip)."""

    def __init__(self, period_ms=10, first_ms=0, true_n=TRUE_N):
        self.state = BreathState()
        self.now_ns = 10**18 + first_ms * MS
        self.period_ms = period_ms
        self.true_n = true_n
        self.begun_ns = self.now_ns

    def read(self, until_ms, inwards=None):
        answer = None
        while self.now_ns < self.begun_ns + until_ms * MS:
            self.now_ns += self.period_ms * MS
            phase = 2.0 * np.pi * (self.now_ns - 10**18) / (400.0 * MS) + np.arange(12)
            way = np.sign(np.sin(phase)) if inwards is None else inwards
            tensions = self.true_n * np.exp(GRIP * way)
            self.state, answer = after_reading(
                self.state, tensions.tolist(), self.now_ns, settle_ns=100 * MS
            )
        return answer

    def mark(self, turn):
        self.state = self.state.marked(Mark(turn, self.now_ns))

    def breathe(self, left=1.0):
        """One breath; at its end all cables stick with a share `left` of their grip inwards."""
        self.mark(0)
        self.read(200)
        self.mark(1)
        self.read(600)
        self.mark(0)
        self.read(800)
        self.mark(BREATH_END)
        return self.read(1200, inwards=left)


@pytest.mark.parametrize("left", [1.0, 0.3])
def test_after_a_breath_readings_are_those_without_friction(left):
    cables = StickingCables()
    np.testing.assert_allclose(cables.breathe(left), TRUE_N, rtol=0.01, atol=1e-9)
    # a change of load that gets through shows in full
    cables.true_n = TRUE_N + 5.0
    change = cables.read(1300, inwards=left) - TRUE_N
    np.testing.assert_allclose(change, 5.0 * np.exp(GRIP * left), atol=0.05 * TRUE_N.max() * GRIP)
    cables.state = cables.state.moved
    stuck_n = (TRUE_N + 5.0) * np.exp(GRIP * left)
    assert cables.read(1400, inwards=left) == pytest.approx(stuck_n)
    assert breath_status(cables.state).level is Level.WARN


def test_a_load_that_comes_during_the_breath_is_not_taken_for_friction():
    cables = StickingCables()
    cables.mark(0)
    cables.read(200)
    cables.mark(1)
    cables.read(600)
    cables.mark(0)
    cables.true_n = TRUE_N + 30.0
    cables.read(800)
    cables.mark(BREATH_END)
    answer = cables.read(1200, inwards=1.0)
    assert answer == pytest.approx((TRUE_N + 30.0) * np.exp(GRIP))
    status = breath_status(cables.state)
    assert status.level is Level.ERROR
    assert "the load changed by" in status.message


AWAY = np.full(8, 0.005)
FRICTION = open_arm("cdsm_friction")


def breath_command(feed, turn, angles_rad=AWAY):
    feed.estimation.command(joint_command(ARM, angles_rad, turn, feed.now_ns))


def test_a_breath_is_no_move_and_has_no_answer_before_a_whole_turn():
    feed = Feed().tared()
    breath_command(feed, 0)
    assert not feed.sample(PUSHED).probabilities
    np.testing.assert_array_equal(feed.estimation.state.motion.command_rad, STRAIGHT)
    assert not feed.estimation.state.motion.shut
    breath_command(feed, 1)
    for _ in range(40):
        assert not feed.sample(PUSHED).probabilities
    breath_command(feed, 2)
    feed.sample(PUSHED)
    assert feed.sample(PUSHED).contact.segment == 3
    assert feed.estimation.state.breath.known


def test_after_a_breather_that_vanished_the_arm_is_where_it_left_it_and_answers_go_on():
    feed = Feed(settle_s=0.1).tared()
    breath_command(feed, 0)
    feed.sample()
    assert not feed.estimation.miss_breather(0.0)
    assert feed.estimation.miss_breather(1.1 * BREATHER_SILENT_AFTER_S)
    np.testing.assert_array_equal(feed.estimation.state.motion.command_rad, AWAY)
    answers = [feed.sample(PUSHED) for _ in range(60)]
    assert answers[-1].contact.segment == 3
    assert "fell silent" in breath_status(feed.estimation.state.breath).message


@pytest.mark.parametrize(
    ("message", "complaint"),
    [
        (cable_offsets(ARM, [math.nan] * 12, 1, 5), "cable_1 is nan"),
        (cable_offsets(ARM, [0.1] * 12, 1, 5), "within"),
        (cable_offsets(ARM, [0.0] * 12, 1, 0), "stamp is 0"),
    ],
)
def test_offsets_that_break_the_contract_change_nothing(message, complaint):
    feed = Feed().tared()
    with pytest.raises(ContractError, match=complaint):
        feed.estimation.offset(message)
    assert feed.sample(PUSHED).contact.segment == 3


def test_there_is_no_force_while_cables_are_offset_by_someone_else():
    feed = Feed(settle_s=0.1).tared()
    feed.estimation.offset(cable_offsets(ARM, [1e-4] * 12))
    answers = [feed.sample(PUSHED) for _ in range(30)]
    assert not feed.estimation.miss_breather(0.0)
    assert not feed.estimation.miss_breather(1e3)
    assert not any(answer.probabilities for answer in answers)
    feed.estimation.offset(cable_offsets(ARM, [0.0] * 12))
    answers = [feed.sample(PUSHED) for _ in range(30)]
    assert answers[-1].contact.segment == 3


class BreathingArm:
    """The simulated arm with friction, which breathes, and an estimation beside it."""

    def __init__(self, over, settings):
        loaded = load_model("cdsm_friction", "")
        self.estimation = Estimation(loaded.machine, loaded.contacts(settings), settings, 0.0)
        self.arm = SimulatedArm(moving_arm(FRICTION, 1e-3), 1e-3, np.radians(20.0), 0.0, 0.0)
        self.over = over
        self.rng = np.random.default_rng(0)
        self.tick = 0

    def go_on(self, seconds):
        for _ in range(round(100 * seconds)):
            self.tick += 1
            self.arm.advance_to(0.01 * self.tick)
            reading = self.arm.reading_n(FRICTION.sensors, self.rng)
            stamp = 10**18 + self.tick * 10_000_000
            raw = message_bytes(reading, stamp)
            answer = self.estimation.sample(raw, stamp, 0.01 * self.tick)
        return answer

    def breathe(self):
        breath = Breath(breath_circle(FRICTION, STRAIGHT), 1)
        while not breath.over:
            deviation, turn = breath.next()
            stamp = 10**18 + self.tick * 10_000_000
            if self.over == "joint_commands":
                self.arm.go_to(deviation)
                self.estimation.command(joint_command(FRICTION, deviation, turn, stamp))
            else:
                offsets = offsets_m(FRICTION, STRAIGHT, deviation)
                self.arm.offset(offsets)
                self.estimation.offset(cable_offsets(FRICTION, offsets, turn, stamp))
            self.go_on(0.4 / SET_POINTS_A_TURN)
        return self.go_on(0.8)


@pytest.mark.slow
@pytest.mark.parametrize("over", ["joint_commands", "cable_offsets"])
def test_forces_under_friction_are_right_after_a_breath_and_gone_when_it_is_gone(over):
    settings = estimation_settings(tare_samples=20, await_breath=True)
    breathing = BreathingArm(over, settings)
    breathing.go_on(0.5)
    assert not breathing.estimation.state.unloaded.known
    breathing.breathe()
    assert breathing.estimation.state.unloaded.known
    force = np.array([0.0, -12.0, 9.0])
    breathing.arm.push(Load(4, force), 0.01 * breathing.tick)
    passive = breathing.go_on(0.3).contact
    contact = breathing.breathe().contact
    assert contact.segment == 4
    np.testing.assert_allclose(
        contact.magnitude_n * np.array(contact.direction), force[1:], atol=0.4
    )
    assert abs(passive.magnitude_n - np.linalg.norm(force)) > 1.0
    breathing.arm.push(Load(4, np.zeros(3)), 0.01 * breathing.tick)
    breathing.go_on(0.3)
    assert breathing.breathe().contact.magnitude_n < 0.2
