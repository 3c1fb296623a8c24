"""An arm at rest, tared, with an estimator that reads it."""

from functools import cache

import numpy as np
import pytest
from estimation_settings import estimation_settings
from joint_commands import joint_command

from cablesense_online.estimation import Estimation
from cablesense_online.models import load_model
from cablesense_online.samples import ProblemKind
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_sim.replay import read_tensions_n

serialization = pytest.importorskip("rclpy.serialization")
sensor_msgs = pytest.importorskip("sensor_msgs.msg")

SETTINGS = estimation_settings(tare_samples=50, largest_misfit=2.3)
BENT = np.deg2rad([6.0, -4.0, 5.0, 3.0, -6.0, 4.0, -3.0, 5.0])
STRAIGHT = np.zeros(8)
PERIOD_NS = 10_000_000

loaded_model = cache(load_model)


def push(arm, command, segment, angle_deg, magnitude_n):
    return normal_force_n(mechanism_of(arm), command, segment, angle_deg, magnitude_n)


class Arm:
    """An arm at rest, tared, with an estimator that reads it every 10 ms."""

    def __init__(self, name="cdsm", command=STRAIGHT, seed=0, model="", **changes):
        loaded = loaded_model(name, model or name)  # of contacts at the points of the arm file
        self.arm, self.rng, self.command = loaded.arm, np.random.default_rng(seed), command
        settings = SETTINGS.model_copy(update=changes)
        self.estimation = Estimation(self.arm, loaded.estimator, settings, 0.0)
        if command.any():
            self.estimation.command(joint_command(self.arm, command))
        self.now_ns = 10**18
        self.tensions = cache(self._tensions)
        while self.estimation.tares.present is None:
            self.sample()

    def _tensions(self, pushed):
        forces = np.reshape(pushed, (4, 3)) if pushed else None
        return solve_equilibrium(mechanism_of(self.arm), self.command, forces).tensions_n

    def reading(self, forces=None):
        true = self.tensions(() if forces is None else tuple(forces.ravel()))
        return np.maximum(read_tensions_n(true, self.arm.sensors, self.rng), 0.0)

    def sample(self, reading=None):
        reading = self.reading() if reading is None else reading
        self.now_ns += PERIOD_NS
        message = sensor_msgs.JointState(name=list(self.arm.cable_names), effort=list(reading))
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(self.now_ns, 10**9)
        self.raw = serialization.serialize_message(message)
        return self.estimation.sample(self.raw, self.now_ns, self.now_ns * 1e-9)

    def misfits(self, reading):
        problem = self.sample(reading).problem
        return problem is not None and problem.kind is ProblemKind.MISFIT
