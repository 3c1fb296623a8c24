"""The simulation of an arm of an arm file: its dynamics, its effects, what its sensors read."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import MAX_JOINT_ANGLE_RAD, Level, Load, read_load
from cablesense_msgs_py.topics import Frames
from cablesense_online.simulated_arm import LONGEST_LAG_S, SimulatedArm
from cablesense_online.simulation import SimulationHealth, SimulationSettings
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.built_arm import as_described, built_arm
from cablesense_sim.dynamics import moving_arm
from cablesense_sim.effects.registry import sensings
from cablesense_sim.loads import contact_of_wrench
from cablesense_sim.touch import touched_places
from cablesense_sim.urdf import urdf_xml

_TIMESTEP_S = 1e-3
"""Of the simulated dynamics."""
_FASTEST_HZ = 1000.0
"""Rate of the readings of an arm whose sensors are faster."""
_SLOWEST_FACTOR = 0.95
"""Of real time, below which the computer is too busy."""
_PERIODS_OF_LAG = 2.0
"""Periods of the sensors by which the simulation may lag before it gives up catching up."""


class ArmSimulation:
    """An arm of an arm file that is simulated: a `simulation.Simulation`."""

    joint_states_hz = 100.0
    largest_command = MAX_JOINT_ANGLE_RAD

    def __init__(self, arm: Arm, settings: SimulationSettings, now_s: float) -> None:
        self._arm = arm
        self.identity = arm.identity
        self.channel_names: Sequence[str] = arm.cable_names
        self.command_names: Sequence[str] = arm.joint_names
        self.joint_names: Sequence[str] = arm.joint_names
        self.rate_hz = settings.rate_hz or min(arm.sensors.rate_hz, _FASTEST_HZ)
        self._mechanism = mechanism_of(arm)
        self._touched_m = touched_places(arm).touched_m
        seed = settings.built_seed
        built = as_described(arm) if seed < 0 else built_arm(arm, seed)
        self._simulated = SimulatedArm(
            moving_arm(arm, _TIMESTEP_S, built),
            _TIMESTEP_S,
            settings.joint_speed_rad_s,
            settings.load_timeout_s,
            now_s,
            sensings=sensings([built.entries]),
            longest_lag_s=max(LONGEST_LAG_S, _PERIODS_OF_LAG / self.rate_hz),
        )

    @property
    def urdf(self) -> str:
        """The arm's description."""
        return urdf_xml(self._arm)

    @property
    def target(self) -> Array:
        """(2N,) the last command."""
        return self._simulated.target_rad

    @property
    def loads(self) -> Sequence[Load]:
        """Those that act."""
        return self._simulated.loads

    @property
    def joint_positions(self) -> Array:
        """(2N,) true joint angles."""
        return self._simulated.joint_angles_rad

    def frames(self, prefix: str) -> Frames:
        """Those of base and segments."""
        return Frames(self._arm.segment_count, prefix)

    def go_to(self, command: Array) -> None:
        """Begin to move to joint angles (2N,).

        Raises:
            CableSenseError: guide plates would touch.
        """
        self._simulated.go_to(command)

    def offset(self, lengths_m: Array) -> None:
        """Begin to add lengths (M,) to the commanded ones of the cables."""
        self._simulated.offset(lengths_m)

    def read_load(self, message: Any, frames: Frames) -> Load:
        """The load of a message in the frame of the base or of a segment, at the present pose.

        Raises:
            CableSenseError: see `messages.read_load` and `contact_of_wrench`.
        """
        pose = self._simulated.joint_angles_rad
        return read_load(
            message, frames, partial(contact_of_wrench, self._mechanism, pose, self._touched_m)
        )

    def push(self, load: Load, now_s: float) -> None:
        """Replace the load on a segment; a zero force removes it.

        Raises:
            LoadError: no such segment or place.
        """
        self._simulated.push(load, now_s)

    def advance_to(self, now_s: float) -> None:
        """Advance the dynamics to a time."""
        self._simulated.advance_to(now_s)

    def reading(self, rng: np.random.Generator | None) -> Array:
        """(M,) tensions in N as the sensors read them; without noise and step without `rng`."""
        return self._simulated.reading_n(self._arm.sensors, rng)

    def health(self, now_s: float) -> SimulationHealth:
        """Whether it keeps up with real time, and has not diverged."""
        pacer = self._simulated.pacer
        factor = pacer.real_time_factor(now_s)
        level = Level.OK
        message = "at real time"
        if factor < _SLOWEST_FACTOR:
            level = Level.WARN
            message = f"at {factor:.2f} of real time: the computer is too busy"
        if self._simulated.resets:
            level = Level.ERROR
            message = "the simulation diverged; it was restarted without loads"
        values = {
            "real time factor": f"{factor:.3f}",
            "time skipped (s)": f"{pacer.skipped_s:.3f}",
            "resets": str(self._simulated.resets),
        }
        return SimulationHealth(level, message, values)
