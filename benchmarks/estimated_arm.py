"""An arm with its model in the estimator's core, which answers serialized readings."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from estimation_settings import estimation_settings
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from cablesense_base import Array
from cablesense_contact.felt_arm import FeltArm
from cablesense_online.answer import Answer
from cablesense_online.estimation import Estimation
from cablesense_online.models import load_model
from cablesense_sim.build import mechanism_of
from cablesense_sim.replay import read_tensions_n

START_NS = 10**18

_loaded = cache(load_model)


class EstimatedArm:
    """One arm, its shipped model, and the estimation that answers its readings."""

    def __init__(
        self, name: str, rng: np.random.Generator, model: str = "", **settings: Any
    ) -> None:
        """`settings` differ from those that benchmarks share; a tare takes 50 readings."""
        loaded = _loaded(name, model)
        self.arm = loaded.arm
        self.rng = rng
        self.mechanism = mechanism_of(self.arm)
        self.settings = estimation_settings(**{"tare_samples": 50} | settings)
        contacts = loaded.contacts(self.settings)
        self.estimation = Estimation(FeltArm(self.arm), contacts, self.settings, 0.0)
        self._message = JointState(name=list(self.arm.cable_names))

    def command(self, angles_rad: Array) -> None:
        """Command angles (2N,) of the joints."""
        names = list(self.arm.joint_names)
        self.estimation.command(JointState(name=names, position=angles_rad.tolist()))

    def read(self, tensions_n: Array) -> Array:
        """Readings of tensions (M,) with noise and step, never below zero."""
        return np.maximum(read_tensions_n(tensions_n, self.arm.sensors, self.rng), 0.0)

    def sample(self, reading_n: Array, now_s: float) -> Answer:
        """The answer to readings (M,) at a time since the start."""
        now_ns = START_NS + round(now_s * 1e9)
        stamp = self._message.header.stamp
        stamp.sec, stamp.nanosec = divmod(now_ns, 10**9)
        self._message.effort = reading_n.tolist()
        return self.estimation.sample(bytes(serialize_message(self._message)), now_ns, now_s)
