"""Samples for an estimation, one after the other, with a stand-in for the model."""

import numpy as np
import pytest

from benchmarks.estimation_settings import estimation_settings
from cablesense_contact.estimate import Estimate
from cablesense_contact.felt_arm import FeltArm
from cablesense_online.contacts import NetworkContacts
from cablesense_online.estimation import Estimation
from cablesense_online.tared_arm import TaredArm
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from tests.helpers.joint_commands import joint_command

serialization = pytest.importorskip("rclpy.serialization")
sensor_msgs = pytest.importorskip("sensor_msgs.msg")

ARM = open_arm("cdsm")
MECHANISM = mechanism_of(ARM)
UNLOADED = solve_equilibrium(MECHANISM, np.zeros(8)).tensions_n
PUSHED = UNLOADED + np.linspace(-5.0, 5.0, 12)
SETTINGS = estimation_settings()


class AnyDifference:
    """A stand-in that finds a contact on segment 3 in any difference from the unloaded state."""

    pose_aware = True

    def __init__(self, probability=0.9, magnitude_n=40.0, std_n=0.1):
        self.probability = probability
        self.magnitude_n = magnitude_n
        self.std_n = std_n
        self.asked = []

    def estimate(self, tension_difference_n, joint_command_rad):
        self.asked.append((tension_difference_n, joint_command_rad))
        touched = self.probability if np.abs(tension_difference_n).max() > 1.0 else 0.0
        probabilities = np.array([1.0 - touched, 0.0, 0.0, touched, 0.0])
        magnitude_n = self.magnitude_n if touched else 0.0
        off_n = 2.0 * self.std_n
        stated = (70.0, magnitude_n, self.std_n, 5.0, magnitude_n - off_n, magnitude_n + off_n)
        return Estimate(probabilities, 3 if touched else 0, *stated)


def message_bytes(tensions, stamp_ns, names=ARM.cable_names):
    message = sensor_msgs.JointState(name=list(names), effort=list(map(float, tensions)))
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    return serialization.serialize_message(message)


class Feed:
    """Samples one after the other, 10 ms apart."""

    def __init__(self, estimator=None, contacts=None, **changes):
        settings = SETTINGS.model_copy(update=changes)
        self.estimator = estimator or AnyDifference()
        if contacts is None:
            tared = TaredArm(ARM, settings)
            hidden_n = settings.hidden_above_n
            contacts = NetworkContacts(ARM, self.estimator, tared, 0.5, hidden_n)
        self.estimation = Estimation(FeltArm(ARM), contacts, settings, 0.0)
        self.now_ns = 10**18

    @property
    def now_s(self):
        return (self.now_ns - 10**18) * 1e-9

    def sample(self, tensions=UNLOADED, names=ARM.cable_names, age_ns=0, raw=None):
        self.now_ns += 10_000_000
        if raw is None:
            raw = message_bytes(tensions, self.now_ns - age_ns, names)
        return self.estimation.sample(raw, self.now_ns, self.now_s)

    def tared(self):
        for _ in range(SETTINGS.tare_samples):
            answer = self.sample()
        assert answer.new_tare is not None
        return self

    def command(self, angles_rad):
        self.estimation.command(joint_command(ARM, angles_rad))
