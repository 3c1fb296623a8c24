"""The arm of the sim node: dynamics at real time, smooth commands, loads that may end."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import Load
from cablesense_online.acting_loads import ActingLoads
from cablesense_sim.arm import Sensors
from cablesense_sim.dynamics import ArmDynamics, ArmQuasiStatics
from cablesense_sim.effects.effect import Sensing
from cablesense_sim.joint_motion import JointMotion
from cablesense_sim.replay import read_tensions_n


class RealTimePacer:
    """Counts the time steps that are due; never more than `longest_lag_s` of them at once.

    A longer delay is skipped and counted in `skipped_s`: catching up would delay the simulation
    further. Times are of one monotonic clock, s.
    """

    def __init__(self, timestep_s: float, longest_lag_s: float, now_s: float) -> None:
        self._timestep_s = timestep_s
        self._longest_lag_s = longest_lag_s
        self._start_s = now_s
        self._report_s = self._start_s
        self._steps = 0
        self._report_steps = 0
        self.skipped_s = 0.0

    def steps_due(self, now_s: float) -> int:
        """Steps to do now; they count as done."""
        behind_s = now_s - self._start_s - self._steps * self._timestep_s
        if behind_s > self._longest_lag_s:
            lost_s = behind_s - self._longest_lag_s
            self._start_s += lost_s
            self.skipped_s += lost_s
            behind_s = self._longest_lag_s
        due = max(0, int(behind_s / self._timestep_s + 1e-6))
        self._steps += due
        return due

    def real_time_factor(self, now_s: float) -> float:
        """Simulated time over real time since the last call."""
        real_s = now_s - self._report_s
        simulated_s = (self._steps - self._report_steps) * self._timestep_s
        self._report_s = now_s
        self._report_steps = self._steps
        return simulated_s / real_s if real_s > 0.0 else 1.0


_OFFSET_SPEED_M_S = 0.02
"""Speed at which cables approach an offset: more than a breath needs."""
LONGEST_LAG_S = 0.1
"""A process that was delayed longer than this continues from there instead of catching up."""


class SimulatedArm:
    """One arm in real time; times are of one monotonic clock, s.

    `resets` counts how often the dynamics were restarted because they diverged.
    """

    def __init__(
        self,
        dynamics: ArmDynamics | ArmQuasiStatics,
        timestep_s: float,
        joint_speed_rad_s: float,
        load_timeout_s: float,
        now_s: float,
        *,
        sensings: Sequence[Sensing] = (),
        longest_lag_s: float = LONGEST_LAG_S,
    ) -> None:
        """With `load_timeout_s` 0 loads act until they are changed.

        `sensings` are the effects of the sensors, in their order; `longest_lag_s` must be longer
        than the time from one `advance_to` to the next.
        """
        self._dynamics = dynamics
        self._timestep_s = timestep_s
        self._motion = JointMotion.at_rest(dynamics.command_rad, joint_speed_rad_s)
        still = np.zeros(dynamics.arm.cable_count)
        self._offset_motion = JointMotion.at_rest(still, _OFFSET_SPEED_M_S)
        self._acting = ActingLoads(load_timeout_s)
        self.pacer = RealTimePacer(timestep_s, longest_lag_s, now_s)
        self._sensings = sensings
        self._began_s = now_s
        self._now_s = self._began_s
        self.resets = 0

    @property
    def target_rad(self) -> Array:
        """(2N,) the last command."""
        return self._motion.target_rad

    def go_to(self, joint_angles_rad: Array) -> None:
        """Begin to move to commanded joint angles (2N,).

        Raises:
            CableSenseError: the arm cannot take such a command; it keeps the one it has.
        """
        self._motion = self._motion.towards(self._dynamics.checked_command(joint_angles_rad))

    def offset(self, lengths_m: Array) -> None:
        """Begin to add lengths (M,) to the commanded ones of the cables."""
        self._offset_motion = self._offset_motion.towards(lengths_m)

    def push(self, load: Load, now_s: float) -> None:
        """Replace the load on a segment; a zero force removes it.

        Raises:
            LoadError: no such segment or place.
        """
        self._dynamics.load(load.segment, load.force_base_n, load.contact_m)
        self._acting.put(load, now_s)

    def advance_to(self, now_s: float) -> None:
        """Advance the simulation to `now_s`."""
        self._now_s = now_s
        for segment in self._acting.ended(now_s):
            self._dynamics.load(segment, np.zeros(3))
        due = self.pacer.steps_due(now_s)
        # an arm that comes to rest when it is read needs no set-points in between
        steps = due if isinstance(self._dynamics, ArmQuasiStatics) else 1
        step_s = steps * self._timestep_s
        while due > 0 and (self._motion.moving or self._offset_motion.moving):
            if self._offset_motion.moving:
                self._offset_motion = self._offset_motion.after(step_s)
                self._dynamics.offset(self._offset_motion.angle_rad)
            if self._motion.moving:
                self._motion = self._motion.after(step_s)
                self._dynamics.command(self._motion.angle_rad)
            self._dynamics.advance(step_s)
            due -= steps
        if due > 0:
            self._dynamics.advance(due * self._timestep_s)
        if not np.isfinite(self._dynamics.tensions_n).all():
            self._dynamics.reset(self._dynamics.command_rad)
            self._acting.clear()
            self.resets += 1

    def reading_n(self, sensors: Sensors, rng: np.random.Generator | None) -> Array:
        """(M,) tensions in N as the sensors read them, without noise and step without `rng`."""
        tensions = self._dynamics.tensions_n
        for sensing in self._sensings:
            tensions = sensing.step(self._now_s - self._began_s, tensions[None])[0]
        tensions = self._dynamics.built.read(tensions)
        return tensions if rng is None else read_tensions_n(tensions, sensors, rng)

    @property
    def joint_angles_rad(self) -> Array:
        """(2N,) true joint angles."""
        return self._dynamics.joint_angles_rad

    @property
    def loads(self) -> list[Load]:
        """The loads that act, by segment."""
        return self._acting.loads
