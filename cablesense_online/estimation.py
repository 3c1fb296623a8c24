"""From serialized tension samples to contacts: everything the estimator node does, without ROS.

The estimator's health beyond its input: model, pose and cables.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from cablesense_base.errors import CableSenseError
from cablesense_msgs_py.diagnostics import Level, Status
from cablesense_msgs_py.joint_states import NamedOrder, joint_command_rad
from cablesense_msgs_py.journal import EventKind, JournalEntry
from cablesense_msgs_py.serialized import EffortReader, Efforts
from cablesense_msgs_py.topics import ContractError
from cablesense_online.answers import (
    ContactDecision,
    EstimatesAlongCourse,
    EstimatesAtRest,
    LoadedModel,
    Outcome,
    answers_of,
)
from cablesense_online.journal import EstimationJournal, EstimationSettings, JournalFollower
from cablesense_online.motion_gate import MotionGate
from cablesense_online.samples import (
    InputHealth,
    ProblemKind,
    SampleCheck,
    SampleClock,
    SampleError,
)
from cablesense_online.tare import Tare, TareModel, UnloadedTensions
from cablesense_sim.arm import Arm


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
        unloaded = UnloadedTensions(arm)
        self._settings = settings
        self._auto_tare = settings.auto_tare
        self._reader = EffortReader()
        self._cable_order = NamedOrder(arm.cable_names, "cables")
        self._joint_order = NamedOrder(arm.joint_names, "joints")
        self._command_rad = np.zeros(arm.joint_count)
        self._journal = EstimationJournal(arm, described or {})
        self._journal.start(self._command_rad)
        self.command_received = False
        self.largest_force_n = 0.0
        self.health = InputHealth(now_s)
        self.clock = SampleClock(settings.stale_after_s)
        self.check = SampleCheck(arm.sensors.range_n, settings.slack_below_n)
        speed_rad_s = settings.joint_speed_rad_s
        self.gate = MotionGate(self._command_rad, speed_rad_s, settings.settle_s)
        self.tare = TareModel(
            unloaded.predict_n, self._command_rad, settings.tare_samples, settings.tare_steady_n
        )
        contact_m = unloaded.mechanism.contact_m.tolist()
        self._decision = ContactDecision(contact_m, settings.contact_threshold)
        self._answers = answers_of(
            estimator, self.tare, unloaded.predict_n, self._command_rad, speed_rad_s
        )
        self._follower = JournalFollower(self._answers)

    def adjust(self, contact_threshold: float, stale_after_s: float, slack_below_n: float) -> None:
        """Take over settings that may change while running."""
        self._settings = replace(
            self._settings,
            contact_threshold=contact_threshold,
            stale_after_s=stale_after_s,
            slack_below_n=slack_below_n,
        )
        self._decision.threshold = contact_threshold
        self.clock.stale_after_s = stale_after_s
        self.check.slack_below_n = slack_below_n
        self._journal.note(EventKind.SETTINGS)

    def start(self, now_s: float) -> None:
        """Samples begin, or begin again, now; those from before count no more."""
        self.health = InputHealth(now_s)
        self.tare.forget_readings()
        self._answers.restore(self._command_rad)
        self._journal.start(self._command_rad)

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
            self._journal.command(command)
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
                self._journal.note(EventKind.CLOCK)
            entry = self._journal.next_entry(
                stamp_ns, self._settings, self._command_rad, self.gate, self.tare
            )
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
        self._journal.note(EventKind.TARE_UNDO)
        return earlier

    def restore(self, entry: JournalEntry) -> None:
        """Answer from the next sample on as the object that made the entry did.

        With another arm than that object's, unloaded tensions follow from the tare and this arm.

        Raises:
            CableSenseError: the entry is of an arm with other joints or cables, or of a pose that
                this arm cannot take.
        """
        self._journal.require_fitting(entry)
        command = np.array(entry.command_rad)
        same_arm = entry.arm == self._journal.arm_identity
        self.tare.restore(
            command,
            np.array(entry.unloaded_n) if same_arm else None,
            np.array(entry.tared_n),
            np.array(entry.tare_command_rad),
        )
        self.gate.restore(
            command, np.array(entry.lowest_rad), np.array(entry.highest_rad), entry.rest_from_ns
        )
        self._follower.follow(entry)
        self._command_rad = command
        self._auto_tare = False
        self._journal.forget()

    @property
    def answers_in_motion(self) -> bool:
        """Whether the model answers while the arm moves."""
        return self._answers.in_motion

    @property
    def vouches(self) -> bool:
        """Whether the answers after `restore` are those of the object that made the entries."""
        return self._follower.vouches

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
        contact = self._decision.decide(
            probabilities, float(estimate.angle_deg), float(estimate.magnitude_n)
        )
        self.largest_force_n = max(self.largest_force_n, contact.magnitude_n)
        return Outcome(contact, probabilities, stamp_ns, entry=entry)

    def _take_tare(self, now_ns: int, how: EventKind) -> Tare:
        tare = self.tare.take(now_ns)
        self._answers.begin()
        self._journal.note(how)
        return tare


def cable_status(estimation: Estimation) -> Status:
    """Which cables are slack. The estimate goes on: statics holds with slack cables too."""
    slack = estimation.check.slack
    names = ", ".join(f"cable_{number}" for number in slack) or "none"
    level, message = (Level.WARN, f"slack: {names}") if slack else (Level.OK, "all cables taut")
    return Status(
        "cables",
        level,
        message,
        {"slack": names, "slack below (N)": f"{estimation.check.slack_below_n:g}"},
    )


def model_status(loaded: LoadedModel, largest_force_n: float, active: bool) -> Status:
    """Which model and arm, and whether the latest forces were within its training."""
    metadata = loaded.estimator.metadata
    values = {
        "model": loaded.model,
        "network": metadata.network,
        "arm": loaded.arm.identity,
        "trained up to (N)": f"{metadata.force_range_n:g}",
        "largest force (N)": f"{largest_force_n:.1f}",
    }
    if not active:
        return Status("model", Level.WARN, "configured, not active", values)
    if largest_force_n > metadata.force_range_n:
        return Status("model", Level.WARN, "forces beyond those it was trained on", values)
    return Status("model", Level.OK, "active", values)


_BLIND = "moving: no estimate until the arm rests"


def pose_status(estimation: Estimation, pose_range_deg: float, refused_commands: int) -> Status:
    """What is known of the arm's pose; the model was trained within ± `pose_range_deg`."""
    values = {
        "commands refused": str(refused_commands),
        "command (deg)": ", ".join(f"{angle:.2f}" for angle in estimation.command_deg),
    }
    if refused_commands:
        return Status("joint_commands", Level.ERROR, "a command was refused; see the log", values)
    if estimation.gate.shut:
        moving = "moving" if estimation.answers_in_motion else _BLIND
        return Status("joint_commands", Level.OK, moving, values)
    if max(map(abs, estimation.command_deg)) > pose_range_deg + 1e-6:
        return Status(
            "joint_commands",
            Level.WARN,
            f"beyond the poses that the model was trained on (±{pose_range_deg:g} degrees)",
            values,
        )
    if not estimation.command_received:
        return Status(
            "joint_commands", Level.WARN, "none received: arm taken to be straight", values
        )
    return Status("joint_commands", Level.OK, "at rest", values)
