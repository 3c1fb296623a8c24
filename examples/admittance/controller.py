"""The controller's cycle without ROS: command, wait for the arm to arrive, measure, step."""

from __future__ import annotations

from collections import Counter, deque

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import ForceState, Level
from cablesense_sim import kinematics
from cablesense_sim.joint_motion import move_duration_s
from cablesense_sim.mechanism import Mechanism
from examples.admittance.law import AdmittanceLaw, AdmittanceSettings, ContactForce
from examples.admittance.trust import FORCE_KNOWN, Confirmation, ContactState, EstimateWatch

FEWEST_SAMPLES = 3  # of a measurement, however slow the sensors are
OWN_COMMANDS_KEPT = 16
REPEAT_S = 0.5  # how often the command in force is repeated while estimates are awaited


class AdmittanceController:
    """Times are monotonic, s; stamps are of the clock of the samples, ns.

    Attributes:
        command_rad: (2N,) the command in force.
        home_rad: (2N,) where to be when nothing touches: the last command of another node.
        contact: of the last measurement; None when nothing touched.
    """

    def __init__(self, mechanism: Mechanism, settings: AdmittanceSettings, now_s: float) -> None:
        self._mechanism = mechanism
        self._settings = settings
        self.law = AdmittanceLaw(mechanism, settings)
        self.watch = EstimateWatch(settings, now_s)
        self.command_rad = np.zeros(mechanism.joint_count)
        self.home_rad = self.command_rad.copy()
        self.contact: ContactForce | None = None
        self._samples: list[tuple[int, int, Array]] = []
        self._confirmation = Confirmation(settings)
        self._own: deque[Array] = deque(maxlen=OWN_COMMANDS_KEPT)
        self._arrived_s = now_s
        self._stepped_s = self._arrived_s
        self._yield_until_s = float("-inf")
        self._repeated_s = self._yield_until_s
        self._commanded = False

    def received_command(self, command_rad: Array, now_s: float) -> bool:
        """A command (2N,) was published; returns whether another node did, whose pose is home."""
        self._commanded = True
        if any(np.array_equal(command_rad, own) for own in (*self._own, self.command_rad)):
            return False
        self.home_rad = command_rad.copy()
        self._yield_until_s = now_s + self._settings.yield_s
        self._confirmation.seen(None, command_rad)
        self._move_to(command_rad, now_s)
        return True

    def received(
        self,
        force: ForceState,
        segment: int,
        force_n: Array,
        stamp_ns: int,
        clock_ns: int,
        now_s: float,
    ) -> Array | None:
        """An estimate came; returns the next command, if one is due.

        In a contact `force_n` (3,) is in the axes of the touched `segment`, from 1; else `segment`
        is 0. `clock_ns` is the present time of the clock that `stamp_ns` is of.
        """
        age_s = (clock_ns - stamp_ns) * 1e-9
        fresh = self.watch.received(force, age_s, now_s) and force in FORCE_KNOWN
        stopped = self.watch.update(now_s) is ContactState.STOPPED
        if not fresh or stopped or self._waits_for(now_s):
            self._samples.clear()
            return None
        if now_s - age_s < self._arrived_s:
            return None
        gap_ns = stamp_ns - self._samples[-1][0] if self._samples else 1
        if not 0 < gap_ns <= self._settings.stale_after_s * 1e9:
            self._samples.clear()
        self._samples.append((stamp_ns, segment, force_n))
        span_ns = stamp_ns - self._samples[0][0]
        enough = span_ns >= self._confirmation.span_s(self.command_rad) * 1e9
        return self._step(now_s) if enough and len(self._samples) >= FEWEST_SAMPLES else None

    def repeated(self, now_s: float) -> Array | None:
        """The command in force, when it is due for an estimator that was restarted.

        Such an estimator assumes a straight arm until it receives a command.
        """
        stopped = self.watch.update(now_s) is ContactState.STOPPED
        due_s = max(self._yield_until_s, self._repeated_s + REPEAT_S)
        if not (stopped and self.watch.publishing(now_s) and self._commanded and now_s >= due_s):
            return None
        self._repeated_s = now_s
        return self.command_rad

    def verdict(self, now_s: float) -> tuple[Level, str]:
        """The state of the controller, for diagnostics."""
        if self.watch.state is ContactState.STOPPED:
            return Level.ERROR, f"stopped: {self.watch.reason}"
        if waits := self._waits_for(now_s):
            return Level.WARN, waits
        if not self._confirmation.confirmed:
            return Level.OK, f"{self.watch.state.value}, not confirmed in a second pose yet"
        bend = np.linalg.norm(self.command_rad.reshape(-1, 2), axis=1)
        if self.contact is not None and (bend >= self.law.radius_rad - 1e-6).any():
            return Level.WARN, "at joint_limit_deg: the remaining force stays"
        return Level.OK, self.watch.state.value

    def _waits_for(self, now_s: float) -> str:
        if self._settings.await_command and not self._commanded:
            return "waits for a first command"
        if now_s < self._yield_until_s:
            return "another node commands; quiet"
        if not self.law.holds(self.command_rad):
            return "the arm was commanded beyond joint_limit_deg; no step is taken"
        return ""

    def _measured(self) -> ContactForce | None:
        """The mean over the samples; those without this contact count as no force."""
        touched = Counter(segment for _, segment, _ in self._samples if segment)
        if not touched:
            return None
        segment = touched.most_common(1)[0][0]
        sum_n = sum(force for _, number, force in self._samples if number == segment)
        rotation = kinematics.segment_rotations(self._mechanism, self.command_rad)[segment - 1]
        return ContactForce(segment, np.asarray(rotation @ sum_n) / len(self._samples))

    def _step(self, now_s: float) -> Array | None:
        self.contact = self._measured()
        elapsed_s = now_s - self._stepped_s
        self._samples.clear()
        self._confirmation.seen(self.contact, self.command_rad)
        target = self.law.step(self.command_rad, self.home_rad, self.contact, elapsed_s)
        target = self._confirmation.shortened(self.command_rad, target)
        self._stepped_s = now_s
        if np.array_equal(target, self.command_rad):
            return None
        self._own.append(target)
        self._commanded = True
        self._move_to(target, now_s)
        return target

    def _move_to(self, command_rad: Array, now_s: float) -> None:
        turn_rad = float(np.abs(command_rad - self.command_rad).max())
        speed_rad_s = float(np.deg2rad(self._settings.joint_speed_deg_s))
        self._arrived_s = now_s + move_duration_s(turn_rad, speed_rad_s)
        self.command_rad = command_rad.copy()
        self._samples.clear()
