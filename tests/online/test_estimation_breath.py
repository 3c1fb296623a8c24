"""An estimation beside an arm that breathes: right after a whole turn, and never a false force."""

import math

import numpy as np
import pytest
from estimation_settings import estimation_settings
from joint_commands import cable_offsets, joint_command
from sample_feed import ARM, PUSHED, UNLOADED, Feed, message_bytes

from cablesense_msgs_py.messages import BREATH_END, Load
from cablesense_msgs_py.topics import ContractError
from cablesense_online.breath_readings import SILENT_AFTER_S
from cablesense_online.breathing import SET_POINTS_A_TURN, Breath, breath_circle, offsets_m
from cablesense_online.estimation import Estimation
from cablesense_online.models import load_model
from cablesense_online.simulated_arm import SimulatedArm
from cablesense_sim.arm import open_arm
from cablesense_sim.dynamics import moving_arm

pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark
STRAIGHT, AWAY = np.zeros(8), np.full(8, 0.005)
FRICTION = open_arm("cdsm_friction")


def breath_command(feed, turn, angles_rad=AWAY):
    feed.estimation.command(joint_command(ARM, angles_rad, turn, feed.now_ns))


def test_a_breath_is_no_move_and_has_no_answer_before_a_whole_turn():
    feed = Feed().tared()
    breath_command(feed, 0)
    assert not feed.sample(PUSHED).probabilities
    np.testing.assert_array_equal(feed.estimation.gate.command_rad, STRAIGHT)
    assert not feed.estimation.gate.shut
    breath_command(feed, 1)
    for _ in range(40):
        assert not feed.sample(PUSHED).probabilities
    breath_command(feed, 2)
    feed.sample(PUSHED)
    assert feed.sample(PUSHED).contact.segment == 3
    assert feed.estimation.breathing.known


def test_a_command_to_elsewhere_cuts_a_breath_short():
    feed = Feed().tared()
    breath_command(feed, 0)
    feed.sample()
    feed.command(0.01 * np.ones(8))
    assert not feed.sample(PUSHED).probabilities
    breath_command(feed, BREATH_END, 0.01 * np.ones(8))
    for _ in range(150):
        feed.sample(UNLOADED)
    assert not feed.estimation.breathing.known
    assert not feed.estimation.gate.shut


def test_after_a_breather_that_vanished_the_arm_is_where_it_left_it_and_answers_go_on():
    feed = Feed(settle_s=0.1).tared()
    breath_command(feed, 0)
    feed.sample()
    assert not feed.estimation.miss_breather(0.0)
    assert feed.estimation.miss_breather(1.1 * SILENT_AFTER_S)
    np.testing.assert_array_equal(feed.estimation.gate.command_rad, AWAY)
    answers = [feed.sample(PUSHED) for _ in range(60)]
    assert answers[-1].contact.segment == 3
    assert "fell silent" in feed.estimation.breathing.status().message


@pytest.mark.parametrize(
    ("message", "complaint"),
    [
        (cable_offsets(ARM, [math.nan] * 12, 1, 5), "cable_1 is nan"),
        (cable_offsets(ARM, [0.1] * 12, 1, 5), "within"),
        (cable_offsets(ARM, [0.0] * 11, 1, 5), "11 values for 12 names"),
        (cable_offsets(open_arm("cdsm_table2"), [0.0] * 9, 1, 5), "missing 'cable_10'"),
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
        loaded = load_model("cdsm_friction", "cdsm")
        self.estimation = Estimation(loaded.arm, loaded.estimator, settings, 0.0)
        self.arm = SimulatedArm(moving_arm(FRICTION, 1e-3), 1e-3, np.radians(20.0), 0.0, 0.0)
        self.over, self.rng, self.tick = over, np.random.default_rng(0), 0

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
    assert breathing.estimation.tares.present is None
    breathing.breathe()
    assert breathing.estimation.tares.present is not None
    for segment, force in ((4, (0.0, -12.0, 9.0)), (2, (0.0, 40.0, 20.0))):
        breathing.arm.push(Load(segment, np.array(force)), 0.01 * breathing.tick)
        passive = breathing.go_on(0.3).contact
        contact = breathing.breathe().contact
        assert contact.segment == segment
        found = contact.magnitude_n * np.array(contact.direction)
        np.testing.assert_allclose(found, force[1:], atol=0.4)
        assert abs(passive.magnitude_n - np.linalg.norm(force)) > 1.0
        breathing.arm.push(Load(segment, np.zeros(3)), 0.01 * breathing.tick)
        breathing.go_on(0.3)
        assert breathing.breathe().contact.magnitude_n < 0.2
