"""From serialized tension samples to contacts: everything the estimator node does, without ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cablesense_msgs_py.contact import NO_CONTACT, Contact
from cablesense_msgs_py.contract_error import ContractError
from cablesense_msgs_py.effort_reader import EffortReader, Efforts
from cablesense_msgs_py.errors import CableSenseError
from cablesense_msgs_py.joint_state import joint_command_rad
from cablesense_msgs_py.named_values import NamedOrder
from cablesense_ros.input_health import InputHealth
from cablesense_ros.motion_gate import MotionGate
from cablesense_ros.sample_check import SampleCheck
from cablesense_ros.sample_clock import SampleClock
from cablesense_ros.sample_error import ProblemKind, SampleError
from cablesense_ros.tare import Tare, TareModel
from cablesense_sim.arm import Arm
from cablesense_sim.effects.chains import amended
from cablesense_sim.effects.entry import entries_of
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.mechanism import Mechanism

Array = NDArray[np.float64]


class Estimate(Protocol):
    """What is read of `cablesense_training.inference.estimator.Estimate`."""

    @property
    def probabilities(self) -> Array:
        """(N+1,) of no contact, segment 1, …."""

    @property
    def angle_deg(self) -> float:
        """Contact angle."""

    @property
    def magnitude_n(self) -> float:
        """Of the force."""


class EstimatesContacts(Protocol):
    """What is used of `cablesense_training.inference.estimator.Estimator`."""

    @property
    def pose_aware(self) -> bool:
        """Whether `estimate` takes the joint command."""

    def estimate(self, tension_difference_n: Array, joint_command_rad: Array | None) -> Estimate:
        """The contact that explains a tension difference (M,)."""


@dataclass(frozen=True)
class EstimationSettings:
    """As the node's parameters of the same names say."""

    contact_threshold: float
    stale_after_s: float
    slack_below_n: float
    tare_samples: int
    tare_steady_n: float
    auto_tare: bool
    joint_speed_rad_s: float
    settle_s: float


class Outcome(NamedTuple):
    """The answer to one sample.

    Attributes:
        contact: `NO_CONTACT` also when the sample was of no use.
        probabilities: (N+1,) of no contact, segment 1, …; empty when nothing was estimated.
        stamp_ns: time of the sample; 0 when it has none, or cannot be trusted.
        problem: why the sample was of no use.
        new_tare: the tare that was taken from this sample on, by itself.
    """

    contact: Contact = NO_CONTACT
    probabilities: Sequence[float] = ()
    stamp_ns: int = 0
    problem: SampleError | None = None
    new_tare: Tare | None = None


class Estimation:
    """Takes samples and commands as they come; gives no force from what cannot be trusted.

    Attributes:
        largest_force_n: of the contacts since the reporter last set it to zero, N.
        health, clock, check, tare, gate: the parts, for diagnostics and services.
        command_received: whether any joint command has come; until then the arm is taken to be
            straight.
    """

    def __init__(
        self, arm: Arm, estimator: EstimatesContacts, settings: EstimationSettings, now_s: float
    ) -> None:
        self._nominal = Mechanism.from_arm(arm)
        self._mechanism = amended(self._nominal, entries_of(arm))
        self._estimator = estimator
        self._contact_m = self._mechanism.contact_m.tolist()
        self._contact_threshold = settings.contact_threshold
        self._stale_after_s = settings.stale_after_s
        self._auto_tare = settings.auto_tare
        self._reader = EffortReader()
        self._cable_order = NamedOrder(arm.cable_names, "cables")
        self._joint_order = NamedOrder(arm.joint_names, "joints")
        self._command_rad = np.zeros(arm.joint_count)
        self.command_received = False
        self.largest_force_n = 0.0
        self.health = InputHealth(now_s)
        self.clock = SampleClock(settings.stale_after_s)
        self.check = SampleCheck(arm.sensors.range_n, settings.slack_below_n)
        self.gate = MotionGate(self._command_rad, settings.joint_speed_rad_s, settings.settle_s)
        self.tare = TareModel(
            self._predict_n, self._command_rad, settings.tare_samples, settings.tare_steady_n
        )

    def adjust(self, contact_threshold: float, stale_after_s: float, slack_below_n: float) -> None:
        """Take over settings that may change while running."""
        self._contact_threshold = contact_threshold
        self._stale_after_s = self.clock.stale_after_s = stale_after_s
        self.check.slack_below_n = slack_below_n

    def start(self, now_s: float) -> None:
        """Samples begin, or begin again, now; those from before count no more."""
        self.health = InputHealth(now_s)
        self.tare.forget_readings()

    def command(self, message: Any, now_s: float) -> None:
        """Take note of a `JointState` of commanded angles.

        Raises:
            CableSenseError: the message breaks the contract, or the arm has no rest at this
            command; the
                command before it stays.
        """
        command = joint_command_rad(message, self._joint_order)
        if not np.array_equal(command, self._command_rad):
            self.tare.command(command)
            self.gate.command(command, now_s)
            self._command_rad = command
        self.command_received = True

    def sample(self, raw: bytes, now_ns: int, now_s: float) -> Outcome:
        """The answer to one serialized `JointState` of tensions.

        Args:
            raw: as it came.
            now_ns: the clock that stamps are of.
            now_s: monotonic time.
        """
        self.health.arrived(now_s)
        try:
            sample = self._read(raw)
            self.health.aged(self.clock.age_s(sample.stamp_ns, now_ns))
            tensions = self._arrange(sample)
            self.check.check(tensions)
            return self._answer(tensions, sample.stamp_ns, now_ns, now_s)
        except SampleError as problem:
            self.health.refused(problem)
            return Outcome(problem=problem)

    @property
    def command_deg(self) -> list[float]:
        """(2N,) the command that counts, degrees."""
        return np.rad2deg(self._command_rad).tolist()

    def stale(self, now_s: float) -> bool:
        """Whether the last message is too long ago for its answer to stand."""
        return self.health.silence_s(now_s) > self._stale_after_s

    def _read(self, raw: bytes) -> Efforts:
        try:
            return self._reader.read(raw)
        except ContractError as error:
            raise SampleError(ProblemKind.MALFORMED, str(error)) from error

    def _arrange(self, sample: Efforts) -> tuple[float, ...]:
        try:
            return self._cable_order.pick(sample.names, sample.values, "effort")
        except ContractError as error:
            raise SampleError(ProblemKind.NAMES, str(error)) from error

    def _answer(
        self, tensions: tuple[float, ...], stamp_ns: int, now_ns: int, now_s: float
    ) -> Outcome:
        if self.gate.moving(now_s):
            return Outcome(stamp_ns=stamp_ns)
        self.tare.add(tensions)
        if self._auto_tare and self.tare.ready:
            self._auto_tare = False
            return Outcome(stamp_ns=stamp_ns, new_tare=self.tare.take(now_ns))
        unloaded = self.tare.unloaded_n
        if unloaded is None:
            return Outcome(stamp_ns=stamp_ns)
        command = self._command_rad if self._estimator.pose_aware else None
        try:
            estimate = self._estimator.estimate(tensions - unloaded, command)
        except CableSenseError as error:
            raise SampleError(ProblemKind.ESTIMATE, str(error)) from error
        probabilities = estimate.probabilities.tolist()
        contact = self._contact(probabilities, estimate)
        return Outcome(contact, probabilities, stamp_ns)

    def _contact(self, probabilities: list[float], estimate: Estimate) -> Contact:
        touched = 1.0 - probabilities[0]
        angle, magnitude = float(estimate.angle_deg), float(estimate.magnitude_n)
        if not (isfinite(sum(probabilities)) and isfinite(angle) and isfinite(magnitude)):
            raise SampleError(
                ProblemKind.ESTIMATE, "the model gave a number that is not finite for this sample"
            )
        if touched < self._contact_threshold or magnitude <= 0.0:
            return NO_CONTACT
        self.largest_force_n = max(self.largest_force_n, magnitude)
        segment = max(range(1, len(probabilities)), key=probabilities.__getitem__)
        return Contact(segment, angle, magnitude, self._contact_m[segment - 1])

    def _predict_n(self, command_rad: Array) -> Array:
        held = held_lengths_m(self._nominal, command_rad)
        return solve_equilibrium(self._mechanism, command_rad, held_m=held).tensions_n
