"""From serialized tension samples to contacts: everything the estimator node does, without ROS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_msgs_py.contact import NO_CONTACT, Contact
from cablesense_msgs_py.contract_error import ContractError
from cablesense_msgs_py.effort_reader import EffortReader, Efforts
from cablesense_msgs_py.errors import CableSenseError
from cablesense_msgs_py.joint_state import joint_command_rad
from cablesense_msgs_py.journal import Event, EventKind, JournalEntry
from cablesense_msgs_py.named_values import NamedOrder
from cablesense_ros.answering import (
    Answers,
    AnswersAlongCourse,
    AnswersAtRest,
    Estimate,
    EstimatesAlongCourse,
    EstimatesAtRest,
)
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

TARES = frozenset({EventKind.TARE, EventKind.AUTO_TARE, EventKind.TARE_UNDO})

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
        new_tare: the tare that was taken by itself; it counts from the next sample on.
        entry: what the answers rest on from this sample on, where that has changed.
    """

    contact: Contact = NO_CONTACT
    probabilities: Sequence[float] = ()
    stamp_ns: int = 0
    problem: SampleError | None = None
    new_tare: Tare | None = None
    entry: JournalEntry | None = None


class Estimation:
    """Takes samples and commands as they come; gives no force from what cannot be trusted.

    An answer follows from the samples in order and from what changed between them, never from when
    they arrived: the clock decides only whether a sample is taken at all. Changes count from the
    next sample that is taken, whose outcome tells them as a journal entry; `restore` makes another
    object answer the same from there on.

    Attributes:
        largest_force_n: of the contacts since the reporter last set it to zero, N.
        health, clock, check, tare, gate: the parts, for diagnostics and services.
        command_received: whether any joint command has come; until then the arm is taken to be
            straight.
    """

    def __init__(
        self,
        arm: Arm,
        estimator: EstimatesAtRest | EstimatesAlongCourse,
        settings: EstimationSettings,
        now_s: float,
        described: Mapping[str, str] | None = None,
    ) -> None:
        """`described` goes into the journal beside the settings."""
        self._arm_identity = arm.identity
        self._described = dict(described or {})
        self._settings = settings
        self._nominal = Mechanism.from_arm(arm)
        self._mechanism = amended(self._nominal, entries_of(arm))
        self._contact_m = self._mechanism.contact_m.tolist()
        self._auto_tare = settings.auto_tare
        self._reader = EffortReader()
        self._cable_order = NamedOrder(arm.cable_names, "cables")
        self._joint_order = NamedOrder(arm.joint_names, "joints")
        self._command_rad = np.zeros(arm.joint_count)
        self._events = [self._start_event()]
        self._followed = False
        self.command_received = False
        self.largest_force_n = 0.0
        self.health = InputHealth(now_s)
        self.clock = SampleClock(settings.stale_after_s)
        self.check = SampleCheck(arm.sensors.range_n, settings.slack_below_n)
        self.gate = MotionGate(self._command_rad, settings.joint_speed_rad_s, settings.settle_s)
        self.tare = TareModel(
            self._predict_n, self._command_rad, settings.tare_samples, settings.tare_steady_n
        )
        self._answers = self._answers_of(estimator)

    def adjust(self, contact_threshold: float, stale_after_s: float, slack_below_n: float) -> None:
        """Take over settings that may change while running."""
        self._settings = replace(
            self._settings,
            contact_threshold=contact_threshold,
            stale_after_s=stale_after_s,
            slack_below_n=slack_below_n,
        )
        self.clock.stale_after_s = stale_after_s
        self.check.slack_below_n = slack_below_n
        self._events.append(Event(EventKind.SETTINGS))

    def start(self, now_s: float) -> None:
        """Samples begin, or begin again, now; those from before count no more."""
        self.health = InputHealth(now_s)
        self.tare.forget_readings()
        self._answers.restore(self._command_rad)
        if self._start_event() not in self._events:
            self._events.append(self._start_event())

    def command(self, message: Any) -> None:
        """Take note of a `JointState` of commanded angles.

        Raises:
            CableSenseError: the message breaks the contract, or the arm has no rest at this
                command; the command before it stays.
        """
        command = joint_command_rad(message, self._joint_order)
        if not np.array_equal(command, self._command_rad):
            self.tare.command(command)
            self.gate.command(command)
            self._answers.command(command)
            self._command_rad = command
            self._events.append(Event(EventKind.COMMAND, tuple(command.tolist())))
        self.command_received = True

    def sample(self, raw: bytes, now_ns: int, now_s: float) -> Outcome:
        """The answer to one serialized `JointState` of tensions.

        Args:
            raw: as it came.
            now_ns: the clock that stamps are of.
            now_s: monotonic time.
        """
        self.health.arrived(now_s)
        stamp_ns, entry = 0, None
        try:
            sample = self._read(raw)
            self.health.aged(self.clock.age_s(sample.stamp_ns, now_ns))
            stamp_ns = sample.stamp_ns or now_ns
            moving = self.gate.moving(stamp_ns)
            if self.gate.stepped_back:
                self._events.append(Event(EventKind.CLOCK))
            entry = self._new_entry(stamp_ns) if self._events else None
            tensions = self._arrange(sample)
            self.check.check(tensions)
            return self._answer(tensions, stamp_ns, moving, entry)
        except SampleError as problem:
            self.health.refused(problem)
            return Outcome(stamp_ns=stamp_ns, problem=problem, entry=entry)

    def take_tare(self, now_ns: int) -> Tare:
        """Take the latest readings as the unloaded state, at `now_ns` since the epoch.

        Raises:
            TareError: too few readings yet, or they do not hold still.
        """
        return self._take_tare(now_ns, EventKind.TARE)

    def undo_tare(self) -> Tare | None:
        """Go back to the tare before the last and give it; none when the last was the first.

        Raises:
            TareError: there is nothing to undo.
        """
        earlier = self.tare.undo()
        self._answers.begin()
        self._events.append(Event(EventKind.TARE_UNDO))
        return earlier

    def restore(self, entry: JournalEntry) -> None:
        """Answer from the next sample on as the object that made the entry did.

        With another arm than that object's, unloaded tensions follow from the tare and this arm.

        Raises:
            CableSenseError: the entry is of an arm with other joints or cables, or of a pose that
                this arm cannot take.
        """
        joints, cables = len(self._joint_order.names), len(self._cable_order.names)
        lengths = {"joint angles": (entry.command_rad, joints)}
        lengths["lowest joint angles"] = (entry.lowest_rad, joints)
        lengths["highest joint angles"] = (entry.highest_rad, joints)
        if entry.tared_n:
            lengths["joint angles at the tare"] = (entry.tare_command_rad, joints)
            lengths["tared tensions"] = (entry.tared_n, cables)
            lengths["unloaded tensions"] = (entry.unloaded_n, cables)
        for what, (numbers, wanted) in lengths.items():
            if len(numbers) != wanted:
                raise ContractError(
                    f"journal: {len(numbers)} {what}; the arm {self._arm_identity} has {wanted}"
                )
        command = np.array(entry.command_rad)
        same_arm = entry.arm == self._arm_identity
        self.tare.restore(
            command,
            np.array(entry.unloaded_n) if same_arm else None,
            np.array(entry.tared_n),
            np.array(entry.tare_command_rad),
        )
        self.gate.restore(
            command, np.array(entry.lowest_rad), np.array(entry.highest_rad), entry.rest_from_ns
        )
        self._follow(entry, command)
        self._command_rad = command
        self._auto_tare = False
        self._events.clear()

    @property
    def answers_in_motion(self) -> bool:
        """Whether the model answers while the arm moves."""
        return self._answers.in_motion

    @property
    def vouches(self) -> bool:
        """Whether the answers after `restore` are those of the object that made the entries.

        A model with memory has a past from the start on.
        """
        return self._followed or not self._answers.in_motion

    @property
    def command_deg(self) -> list[float]:
        """(2N,) the command that counts, degrees."""
        return np.rad2deg(self._command_rad).tolist()

    def stale(self, now_s: float) -> bool:
        """Whether the last message is too long ago for its answer to stand."""
        return self.health.silence_s(now_s) > self._settings.stale_after_s

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
        self, tensions: tuple[float, ...], stamp_ns: int, moving: bool, entry: JournalEntry | None
    ) -> Outcome:
        if moving and not self._answers.in_motion:
            return Outcome(stamp_ns=stamp_ns, entry=entry)
        if not moving:
            self.tare.add(tensions)
        try:
            estimate = self._answers.estimate(tensions, stamp_ns)
        except CableSenseError as error:
            raise SampleError(ProblemKind.ESTIMATE, str(error)) from error
        if not moving and self._auto_tare and self.tare.ready:
            self._auto_tare = False
            tare = self._take_tare(stamp_ns, EventKind.AUTO_TARE)
            return Outcome(stamp_ns=stamp_ns, new_tare=tare, entry=entry)
        if estimate is None:
            return Outcome(stamp_ns=stamp_ns, entry=entry)
        probabilities = estimate.probabilities.tolist()
        contact = self._contact(probabilities, estimate)
        return Outcome(contact, probabilities, stamp_ns, entry=entry)

    def _contact(self, probabilities: list[float], estimate: Estimate) -> Contact:
        touched = 1.0 - probabilities[0]
        angle, magnitude = float(estimate.angle_deg), float(estimate.magnitude_n)
        if not (isfinite(sum(probabilities)) and isfinite(angle) and isfinite(magnitude)):
            raise SampleError(
                ProblemKind.ESTIMATE, "the model gave a number that is not finite for this sample"
            )
        if touched < self._settings.contact_threshold or magnitude <= 0.0:
            return NO_CONTACT
        self.largest_force_n = max(self.largest_force_n, magnitude)
        segment = max(range(1, len(probabilities)), key=probabilities.__getitem__)
        return Contact(segment, angle, magnitude, self._contact_m[segment - 1])

    def _take_tare(self, now_ns: int, how: EventKind) -> Tare:
        tare = self.tare.take(now_ns)
        self._answers.begin()
        self._events.append(Event(how))
        return tare

    def _new_entry(self, before_ns: int) -> JournalEntry:
        events, self._events = tuple(self._events), []
        tare, unloaded = self.tare.present, self.tare.unloaded_n
        lowest, highest = self.gate.range_rad
        return JournalEntry(
            before_ns=before_ns,
            events=events,
            arm=self._arm_identity,
            settings={
                **self._described,
                "joints": " ".join(self._joint_order.names),
                **{name: repr(value) for name, value in asdict(self._settings).items()},
            },
            command_rad=tuple(self._command_rad.tolist()),
            lowest_rad=tuple(lowest.tolist()),
            highest_rad=tuple(highest.tolist()),
            rest_from_ns=self.gate.rest_from_ns,
            unloaded_n=() if unloaded is None else tuple(unloaded.tolist()),
            tared_n=() if tare is None else tuple(tare.measured_n.tolist()),
            tare_command_rad=() if tare is None else tuple(tare.command_rad.tolist()),
        )

    def _start_event(self) -> Event:
        return Event(EventKind.START, tuple(self._command_rad.tolist()))

    def _follow(self, entry: JournalEntry, command_rad: Array) -> None:
        """Let what remembers go through the same events, from its own past where it has one."""
        if not self._followed:
            self._answers.restore(command_rad)
        for event in entry.events:
            if event.kind is EventKind.START and event.command_rad:
                self._answers.restore(np.array(event.command_rad))
            elif event.kind is EventKind.COMMAND:
                self._answers.command(np.array(event.command_rad))
            elif event.kind in TARES:
                self._answers.begin()
            self._followed |= event.kind is EventKind.START

    def _answers_of(self, estimator: EstimatesAtRest | EstimatesAlongCourse) -> Answers:
        if isinstance(estimator, EstimatesAlongCourse):
            speed = self._settings.joint_speed_rad_s
            return AnswersAlongCourse(
                estimator, self.tare, self._predict_n, self._command_rad, speed
            )
        return AnswersAtRest(estimator, self.tare, self._command_rad)

    def _predict_n(self, command_rad: Array) -> Array:
        held = held_lengths_m(self._nominal, command_rad)
        return solve_equilibrium(self._mechanism, command_rad, held_m=held).tensions_n
