"""The admittance controller without ROS: estimates in, joint commands out, in a cycle.

Command, wait until the arm must have arrived, average the estimates from then on, step. With an
estimator that gives none until the arm has settled this is a measure-step-wait cycle; with one
that estimates in motion the cycle is as short as move and average.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import ForceState, Level, Status
from cablesense_online.admittance.estimate_watch import ContactState, EstimateWatch
from cablesense_online.admittance.law import (
    AdmittanceLaw,
    AdmittanceSettings,
    Confirmation,
    ContactForce,
    ForceAverage,
    Reach,
)
from cablesense_sim import kinematics
from cablesense_sim.joint_motion import move_duration_s
from cablesense_sim.mechanism import Mechanism

OWN_COMMANDS_KEPT = 16
REPEAT_S = 0.5
"""While estimates are awaited, the command in force is repeated this often."""


class AdmittanceController:
    """Times are monotonic, s; stamps are of the clock of the samples, ns.

    Attributes:
        command_rad: (2N,) the command in force.
        home_rad: (2N,) where to be when nothing touches: the last command of another node.
        contact: of the last measurement; None when nothing touched.
        at_limit: whether the last step ended at the edge of the reach.
        step_count: steps sent.
    """

    def __init__(self, mechanism: Mechanism, settings: AdmittanceSettings, now_s: float) -> None:
        self._mechanism = mechanism
        self._settings = settings
        self.law = AdmittanceLaw(mechanism, Reach(mechanism, settings.joint_limit_rad), settings)
        self.command_rad = np.zeros(mechanism.joint_count)
        self.home_rad = self.command_rad.copy()
        self.watch = EstimateWatch(settings, now_s)
        self._average = ForceAverage(settings.stale_after_s)
        self._confirmation = Confirmation(settings)
        self._own: deque[Array] = deque(maxlen=OWN_COMMANDS_KEPT)
        self._arrived_s = self._stepped_s = now_s
        self._yield_until_s = self._repeated_s = float("-inf")
        self._in_force = False
        self.contact: ContactForce | None = None
        self.at_limit = False
        self.step_count = 0

    def received_command(self, command_rad: Array, now_s: float) -> bool:
        """A command (2N,) was on the topic; gives whether it was another node's.

        Such a command is the new home, whatever it is, and none is sent for a while.
        """
        self._in_force = True
        own = any(np.array_equal(command_rad, sent) for sent in self._own)
        if own or np.array_equal(command_rad, self.command_rad):
            return False
        self.home_rad = command_rad.copy()
        self._yield_until_s = now_s + self._settings.yield_s
        self._confirmation.forget()
        self._go_on_from(command_rad, now_s)
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
        """What is known of the force came; gives the next command.

        During a contact `force_n` (3,) is in the axes of the touched `segment`, from 1; else that
        is 0. `stamp_ns` is the sample's, `clock_ns` the present time of the clock that sets it.
        """
        age_s = (clock_ns - stamp_ns) * 1e-9
        fresh = self.watch.received(force, age_s, now_s) and force.known
        state = self.watch.update(now_s)
        if not fresh or state is ContactState.STOPPED or self._waits_for(now_s):
            self._average.clear()
            return None
        if now_s - age_s < self._arrived_s:
            return None
        self._average.add(stamp_ns, segment, force_n)
        span_s = self._confirmation.span_s(self.command_rad)
        return self._step(now_s) if self._average.spans(span_s) else None

    def repeated(self, now_s: float) -> Array | None:
        """The command in force, when it should be repeated.

        An estimator that was started anew takes the arm to be straight until it gets a command.
        While it publishes but is not trusted yet, the command in force is repeated; the arm has
        it already.
        """
        stopped = self.watch.update(now_s) is ContactState.STOPPED
        due_s = max(self._yield_until_s, self._repeated_s + REPEAT_S)
        wanted = stopped and self.watch.publishing(now_s) and self._in_force
        if not wanted or now_s < due_s:
            return None
        self._repeated_s = now_s
        return self.command_rad

    def _waits_for(self, now_s: float) -> str:
        """Why no step is taken at present, whatever touches; empty where one may be."""
        if self._settings.await_command and not self._in_force:
            return "waits for a first command"
        if now_s < self._yield_until_s:
            return "another node commands; quiet"
        if not self.law.reach.holds(self.command_rad):
            return "the arm was commanded beyond joint_limit_deg; no step is taken"
        return ""

    def status(self, active: bool, commanders: int, now_s: float) -> Status:
        """Phase, last contact and pose; `commanders` publish joint commands, this node too."""
        last = "none"
        if self.contact is not None:
            magnitude_n = np.linalg.norm(self.contact.force_base_n)
            last = f"segment {self.contact.segment}, {magnitude_n:.2f} N"
        command_deg, home_deg = (
            ", ".join(f"{angle:.3f}" for angle in np.rad2deg(angles))
            for angles in (self.command_rad, self.home_rad)
        )
        values = {
            "sight": self.watch.state.value,
            "last contact": last,
            "steps": str(self.step_count),
            "command (deg)": command_deg,
            "home (deg)": home_deg,
            "commanders": str(commanders),
        }
        return Status("control", *self._verdict(active, commanders, now_s), values)

    def _verdict(self, active: bool, commanders: int, now_s: float) -> tuple[Level, str]:
        if not active:
            return Level.OK, "configured, not active: no commands are sent"
        if self.watch.state is ContactState.STOPPED:
            return Level.ERROR, f"stopped: {self.watch.reason}"
        waits = self._waits_for(now_s)
        if waits:
            return Level.WARN, waits
        if not self._confirmation.confirmed:
            return Level.OK, f"{self.watch.state.value}, not confirmed in another pose yet"
        if self.contact is not None and self.at_limit:
            return Level.WARN, "at joint_limit_deg: what force is left stays"
        if commanders > 1:
            return Level.OK, f"{self.watch.state.value}; {commanders} nodes can command"
        return Level.OK, self.watch.state.value

    def _step(self, now_s: float) -> Array | None:
        segment, local_n = self._average.take()
        self.contact = None
        if segment:
            rotation = kinematics.segment_rotations(self._mechanism, self.command_rad)
            self.contact = ContactForce(segment, np.asarray(rotation[segment - 1] @ local_n))
        self._confirmation.seen(self.contact, self.command_rad)
        target = self._confirmation.shortened(
            self.command_rad,
            self.law.step(self.command_rad, self.home_rad, self.contact, now_s - self._stepped_s),
        )
        self._stepped_s = now_s
        bent = np.linalg.norm(target.reshape(-1, 2), axis=1)
        self.at_limit = bool((bent >= self.law.reach.radius_rad - 1e-6).any())
        if np.array_equal(target, self.command_rad):
            return None
        self._own.append(target)
        self._in_force = True
        self.step_count += 1
        self._go_on_from(target, now_s)
        return target

    def _go_on_from(self, command_rad: Array, now_s: float) -> None:
        turn = float(np.abs(command_rad - self.command_rad).max())
        self._arrived_s = now_s + move_duration_s(turn, self._settings.joint_speed_rad_s)
        self.command_rad = command_rad.copy()
        self._average.clear()
