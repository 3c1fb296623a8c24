"""Models are asked at rest, or along the course that the joints are taken to follow."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from cablesense_online.answers import AnswersAlongCourse, AnswersAtRest, answers_of
from cablesense_online.estimation import Estimation
from cablesense_online.journal import EstimationSettings
from cablesense_online.tare import TareModel
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.joint_motion import JointMotion
from cablesense_training.inference.temporal_estimator import TemporalEstimator

ARM = open_arm("cdsm")
MECHANISM = mechanism_of(ARM)
STRAIGHT, BENT = np.zeros(8), np.deg2rad([8.0, -5.0, 3.0, 0.0, -9.0, 4.0, 2.0, 7.0])
SPEED_RAD_S = 0.35


def predicted_n(command_rad):
    return solve_equilibrium(MECHANISM, command_rad).tensions_n


class Listener:
    """Stands in for a model with memory and notes what it is asked."""

    def __init__(self):
        self.asked, self.forgot, self.tared = [], 0, 0

    def estimate(self, tension_difference_n, angle, speed, acceleration, time_s):
        self.asked.append((tension_difference_n, angle, speed, acceleration, time_s))
        return SimpleNamespace(probabilities=np.eye(5)[0], angle_deg=0.0, magnitude_n=0.0)

    def forget(self):
        self.forgot += 1

    def tare(self):
        self.tared += 1


@pytest.fixture
def tare():
    tares = TareModel(predicted_n, STRAIGHT, 1, 1.0)
    tares.add((predicted_n(STRAIGHT) + 0.5).tolist())
    tares.take(0)
    return tares


def _through(answers, tare, ticks=120):
    answers.command(BENT)
    tare.command(BENT)
    for tick in range(ticks):
        answers.estimate(predicted_n(STRAIGHT).tolist(), 10**18 + 10_000_000 * tick)


def test_set_points_are_those_of_the_joints_on_their_way(tare):
    model = Listener()
    _through(AnswersAlongCourse(model, tare, predicted_n, STRAIGHT, SPEED_RAD_S), tare)
    motion = JointMotion(STRAIGHT, SPEED_RAD_S)
    motion.go_to(BENT)
    for _, angle, speed, acceleration, _ in model.asked:
        for found, wanted in zip((angle, speed, acceleration), motion.state, strict=True):
            np.testing.assert_allclose(found, wanted, atol=1e-9)
        motion.advance(0.01)
    np.testing.assert_array_equal(model.asked[-1][1], BENT)
    assert (model.asked[-1][2] == 0.0).all()


def test_the_tare_is_carried_along_the_way(tare):
    model = Listener()
    answers = AnswersAlongCourse(model, tare, predicted_n, STRAIGHT, SPEED_RAD_S)
    _through(answers, tare)
    for difference, angle, *_ in model.asked:
        unloaded = predicted_n(angle) + 0.5
        np.testing.assert_allclose(predicted_n(STRAIGHT) - difference, unloaded, atol=0.1)


def test_a_tare_and_a_restart_are_told_to_the_model(tare):
    model = Listener()
    answers = AnswersAlongCourse(model, tare, predicted_n, STRAIGHT, SPEED_RAD_S)
    before = model.forgot
    answers.begin()
    assert (model.tared, model.forgot) == (1, before)
    answers.restore(BENT)
    assert model.forgot == before + 1


def test_without_a_tare_there_is_no_estimate_but_the_course_is_followed():
    nothing = TareModel(predicted_n, STRAIGHT, 1, 1.0)
    model = Listener()
    course = AnswersAlongCourse(model, nothing, predicted_n, STRAIGHT, SPEED_RAD_S)
    rest = AnswersAtRest(SimpleNamespace(pose_aware=True, estimate=None), nothing, STRAIGHT)
    for answers in (course, rest):
        assert answers.estimate([50.0] * 12, 1) is None
    (difference, *_), *_ = model.asked
    assert (difference == 0.0).all()


def test_a_model_with_memory_is_asked_along_the_course_and_another_at_rest(tare):
    for model, in_motion in (
        (Listener(), True),
        (SimpleNamespace(pose_aware=True, estimate=None), False),
    ):
        answers = answers_of(model, tare, predicted_n, STRAIGHT, SPEED_RAD_S)
        assert answers.in_motion is in_motion


serialization = pytest.importorskip("rclpy.serialization")
sensor_msgs = pytest.importorskip("sensor_msgs.msg")

SETTINGS = EstimationSettings(
    contact_threshold=0.5,
    stale_after_s=0.2,
    slack_below_n=1.0,
    tare_samples=5,
    tare_steady_n=1.0,
    auto_tare=True,
    joint_speed_rad_s=SPEED_RAD_S,
    settle_s=0.2,
)


def _raw(tensions_n, stamp_ns):
    message = sensor_msgs.JointState(name=list(ARM.cable_names), effort=tensions_n.tolist())
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    return serialization.serialize_message(message)


def _run(estimation, samples, command_at, answers, entries):
    for tick, tensions in samples:
        if tick == command_at:
            estimation.command(SimpleNamespace(name=ARM.joint_names, position=BENT))
        stamp_ns = 10**18 + 10_000_000 * tick
        outcome = estimation.sample(_raw(tensions, stamp_ns), stamp_ns, 0.01 * tick)
        answers[tick] = outcome
        if outcome.entry is not None:
            entries[tick] = outcome.entry


@pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark
def test_a_model_with_memory_answers_in_motion_and_again_from_the_journal(temporal_model_file):
    rng = np.random.default_rng(0)
    tensions = predicted_n(STRAIGHT) + np.cumsum(rng.normal(0.0, 0.3, (150, 12)), axis=0)
    tensions[:10] = predicted_n(STRAIGHT)
    samples = list(enumerate(tensions))
    model = TemporalEstimator.load(temporal_model_file, ARM)
    answers, entries = {}, {}
    _run(Estimation(ARM, model, SETTINGS, 0.0), samples, 30, answers, entries)
    assert all(answers[tick].probabilities for tick in range(30, 150))  # in motion, too

    again = Estimation(ARM, TemporalEstimator.load(temporal_model_file, ARM), SETTINGS, 0.0)
    assert not again.vouches
    for tick, sample in samples:
        if tick in entries:
            again.restore(entries[tick])
        stamp_ns = 10**18 + 10_000_000 * tick
        outcome = again.sample(_raw(sample, stamp_ns), stamp_ns, 0.01 * tick)
        assert again.vouches
        assert outcome.contact == answers[tick].contact
        assert list(outcome.probabilities) == list(answers[tick].probabilities)

    late = Estimation(ARM, TemporalEstimator.load(temporal_model_file, ARM), SETTINGS, 0.0)
    late.restore(replace(entries[30], events=entries[30].events[-1:]))
    assert not late.vouches  # a past that no one recorded
