"""Models are asked at rest, or along the joints' trajectory."""

from types import SimpleNamespace

import numpy as np
import pytest

from cablesense_online.models import ContactModel, HistoryDependentModel
from cablesense_online.motion_gate import MotionGate
from cablesense_online.tare import Tares
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.joint_motion import JointMotion

ARM = open_arm("cdsm")
MECHANISM = mechanism_of(ARM)
STRAIGHT, BENT = np.zeros(8), np.deg2rad([8.0, -5.0, 3.0, 0.0, -9.0, 4.0, 2.0, 7.0])
SPEED_RAD_S = 0.35


def predicted_n(command_rad):
    return solve_equilibrium(MECHANISM, command_rad).tensions_n


class Listener:
    """Stands in for a history-dependent estimator and keeps its inputs."""

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
    tares = Tares(predicted_n, STRAIGHT, 1, 1.0)
    tares.add((predicted_n(STRAIGHT) + 0.5).tolist())
    tares.take(STRAIGHT, 0)
    return tares


def _through(answers, tare, ticks=120):
    answers.command(BENT)
    tare.command(BENT)
    for tick in range(ticks):
        answers.estimate(predicted_n(STRAIGHT).tolist(), 10**18 + 10_000_000 * tick)


@pytest.mark.slow
def test_set_points_and_tare_are_those_of_the_joints_on_their_way(tare):
    model = Listener()
    _through(HistoryDependentModel(model, tare, predicted_n, STRAIGHT, SPEED_RAD_S), tare)
    motion = JointMotion(STRAIGHT, SPEED_RAD_S)
    motion.go_to(BENT)
    for difference, angle, speed, acceleration, _ in model.asked:
        unloaded = predicted_n(angle) + 0.5
        np.testing.assert_allclose(predicted_n(STRAIGHT) - difference, unloaded, atol=0.1)
        for found, wanted in zip((angle, speed, acceleration), motion.state, strict=True):
            np.testing.assert_allclose(found, wanted, atol=1e-9)
        motion.advance(0.01)
    np.testing.assert_array_equal(model.asked[-1][1], BENT)
    assert (model.asked[-1][2] == 0.0).all()


def test_without_a_tare_there_is_no_estimate_but_the_trajectory_is_followed():
    nothing = Tares(predicted_n, STRAIGHT, 1, 1.0)
    model = Listener()
    along = HistoryDependentModel(model, nothing, predicted_n, STRAIGHT, SPEED_RAD_S)
    memoryless = SimpleNamespace(pose_aware=True, estimate=None)
    at_rest = ContactModel(memoryless, nothing, MotionGate(STRAIGHT, SPEED_RAD_S, 0.2))
    for answers in (along, at_rest):
        assert answers.estimate([50.0] * 12, 1) is None
    (difference, *_), *_ = model.asked
    assert (difference == 0.0).all()
