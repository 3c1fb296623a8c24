"""What diagnostics say of an estimator: every sentence about its state, and what is counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from cablesense_base import CableSenseError
from cablesense_contact.calibration import Calibration, Calibrator
from cablesense_contact.felt import ChannelLimits, FeltMachine
from cablesense_contact.law import Law
from cablesense_contact.reference_contacts import KnownForce, ReferenceContacts
from cablesense_msgs_py.messages import ForceState, Level, Status
from cablesense_online.answer import Answer
from cablesense_online.breath_readings import BreathState
from cablesense_online.calibrated_arm import CalibratedState
from cablesense_online.contact_estimator import ContactEstimator, EstimationState, Sample
from cablesense_online.models import Loaded
from cablesense_online.samples import ProblemKind, SampleError
from cablesense_online.settings import EstimationSettings
from cablesense_online.tare import UnloadedState, refusal, utc_text

_BLIND_S = 3.0
"""Time without an estimate after which a warning is due,"""
_SOME_COMMANDS = 3
"""if this number of commands came."""


class SampleCounts:
    """Counts samples between reports, and in total.

    Attributes:
        largest_force_n: that was answered since the last report.
        largest_age_s: of a sample since then.
        commands: that have come since the last estimate.
        slack_cables: numbers, from 1, of the cables that were slack at the last sample.
    """

    def __init__(self, now_s: float) -> None:
        """Count from monotonic time `now_s` on."""
        self.largest_force_n = 0.0
        self.largest_age_s = 0.0
        self.commands = 0
        self.slack_cables: Sequence[int] = ()
        self._report_s = now_s
        self._last_arrival_s = now_s
        self._received = False
        self._blind_since_ns: int | None = None
        self._last_problem = ""
        self._arrived = 0
        self._total_missing = 0
        self._total_refused = 0
        self._refused: Counter[ProblemKind] = Counter()

    def count(self, sample: Sample, answer: Answer) -> None:
        """Count a sample with its answer."""
        self._arrived += 1
        self._received = True
        self._last_arrival_s = sample.now_s
        if answer.stamp_ns:
            age_s = (sample.now_ns - answer.stamp_ns) * 1e-9
            self.largest_age_s = max(self.largest_age_s, age_s)
        if answer.problem is not None:
            self.refuse(answer.problem)
            return
        self.slack_cables = answer.slack_cables
        if answer.probabilities:
            self._blind_since_ns = None
            self.commands = 0
        elif answer.force is ForceState.MOVING and self._blind_since_ns is None:
            self._blind_since_ns = answer.stamp_ns
        if answer.contacts:
            self.largest_force_n = max(self.largest_force_n, answer.contacts[0].magnitude_n)

    def refuse(self, problem: SampleError) -> None:
        """Count a sample that could not be used."""
        self._refused[problem.kind] += 1
        self._total_refused += 1
        self._last_problem = str(problem)

    def silence_s(self, now_s: float) -> float:
        """Time since the last message, or since the start before the first."""
        return now_s - self._last_arrival_s

    def blind_s(self, stamp_ns: int) -> float:
        """Time without an estimate until a stamp, in which commands came; else 0."""
        if self._blind_since_ns is None or self.commands < _SOME_COMMANDS:
            return 0.0
        return (stamp_ns - self._blind_since_ns) * 1e-9

    def status(
        self, now_s: float, missing: int, publisher_count: int, stale_after_s: float
    ) -> Status:
        """The report since the last one, with which the next one begins.

        Args:
            now_s: monotonic time.
            missing: how many samples were lost since the last report.
            publisher_count: how many publishers are on the topic.
            stale_after_s: largest age of a sample.
        """
        self._total_missing += missing
        rate = self._arrived / max(now_s - self._report_s, 1e-9)
        level, message = self._verdict(now_s, missing, publisher_count, stale_after_s)
        values = {
            "rate (Hz)": f"{rate:.1f}",
            "largest age (s)": f"{self.largest_age_s:.4f}",
            "dropped": str(missing),
            "dropped in all": str(self._total_missing),
            "refused": str(sum(self._refused.values())),
            "refused in all": str(self._total_refused),
            "publishers": str(publisher_count),
        }
        values |= {f"refused: {kind.value}": str(count) for kind, count in self._refused.items()}
        if self._last_problem:
            values["last refusal"] = self._last_problem
        self._report_s = now_s
        self._arrived = 0
        self.largest_age_s = 0.0
        self._refused.clear()
        return Status("cable_tensions", level, message, values)

    def _verdict(
        self, now_s: float, missing: int, publisher_count: int, stale_after_s: float
    ) -> tuple[Level, str]:
        silence = self.silence_s(now_s)
        if not self._received:
            return Level.STALE, "no sample received yet"
        if silence > stale_after_s:
            return Level.STALE, f"no sample for {silence:.1f} s"
        others = f"{publisher_count} publishers; one arm has one, and one is used"
        if publisher_count > 1 and self._refused[ProblemKind.PUBLISHER]:
            return Level.ERROR, others
        if self._refused:
            kinds = ", ".join(f"{count} {kind.value}" for kind, count in self._refused.items())
            return Level.ERROR, f"samples refused: {kinds}"
        if publisher_count > 1:
            silent = "the others are silent (one that was killed is counted for 5 s)"
            return Level.WARN, f"{others}; {silent}"
        if missing:
            lost = f"{missing} sample{'s' if missing != 1 else ''} lost"
            why = "on the way, or left out as they came faster than answers"
            return Level.WARN, f"{lost} {why}; the others are used"
        return Level.OK, "receiving"


def model_status(loaded: Loaded, largest_force_n: float, *, active: bool) -> Status:
    """The model in use, with the largest force since the last report."""
    summary = loaded.summary
    values = {
        "model": loaded.path,
        "network": summary.network,
        "arm": loaded.machine.identity,
        "up to (N)": f"{summary.force_range_n:g}",
        "largest force (N)": f"{largest_force_n:.1f}",
    }
    if not active:
        return Status("model", Level.WARN, "configured, not active", values)
    if largest_force_n > summary.force_range_n:
        return Status("model", Level.WARN, "forces beyond those that it is for", values)
    return Status("model", Level.OK, "active", values)


def cables_status(
    slack_cables: Sequence[int], slack_below_n: float, channel_names: Sequence[str]
) -> Status:
    """Which cables are slack. Estimates continue: statics holds with slack cables too."""
    names = ", ".join(channel_names[number - 1] for number in slack_cables)
    values = {"slack": names or "none", "slack below (N)": f"{slack_below_n:g}"}
    if names:
        return Status("cables", Level.WARN, f"slack: {names}", values)
    return Status("cables", Level.OK, "all cables taut", values)


def motion_status(
    estimator: ContactEstimator,
    state: EstimationState,
    blind_s: float,
    pose_range_deg: float,
    refused: int,
) -> Status:
    """Command, motion and pose.

    Args:
        estimator: that answers.
        state: its present state.
        blind_s: for how long there was no estimate though commands came.
        pose_range_deg: the model was made for within ± this.
        refused: number of commands refused since the last report.
    """
    motion = state.motion
    command_deg = np.rad2deg(motion.command_rad).tolist()
    values = {
        "commands refused": str(refused),
        "command (deg)": ", ".join(f"{angle:.2f}" for angle in command_deg),
    }
    moves = motion.shut or estimator.gate.turning(motion)
    level = Level.WARN
    if refused:
        level = Level.ERROR
        message = "a command was refused; see the log"
    elif moves and blind_s > _BLIND_S:
        follow_rad_s = estimator.settings.follow_rad_s
        message = (
            f"moving: no estimate for {blind_s:.0f} s, as commands continue that exceed "
            f"{np.rad2deg(follow_rad_s):g} deg/s (follow_deg_s), or the arm lags behind them"
        )
    elif moves:
        level = Level.OK
        message = "moving slowly: its set-points are followed"
        if motion.shut:
            message = "moving: no estimate until the arm rests"
    elif max(map(abs, command_deg)) > pose_range_deg + 1e-6:
        message = f"beyond the poses that the model is for (±{pose_range_deg:g} degrees)"
    elif not state.is_commanded:
        message = "none received: assumed to be in its first pose (an arm: straight)"
    else:
        level = Level.OK
        message = "at rest"
    return Status("joint_commands", level, message, values)


def breath_status(breath: BreathState) -> Status | None:
    """The results of breathing; None where there has been none."""
    if breath.problem:
        message = f"{breath.problem}; friction is in the readings"
        return Status("breathing", Level.ERROR, message)
    loop_n = 0.5 * (breath.readings.highest_n - breath.readings.lowest_n)
    values = {"friction of each cable (N)": ", ".join(f"{half:.1f}" for half in loop_n)}
    level = Level.OK
    if breath.breathing:
        message = "breathing" if breath.known else "breathing: no estimate before a whole turn"
    elif breath.offset_n.size:
        values["readings corrected by (N)"] = ", ".join(f"{n:+.1f}" for n in breath.offset_n)
        message = "breathed at this command"
    elif breath.ended_ns:
        message = "coming to rest after a breath"
    elif loop_n.size:
        level = Level.WARN
        message = "moved since the last breath: friction is in the readings"
    else:
        return None
    return Status("breathing", level, message, values)


def awaited_tare(
    state: EstimationState, settings: EstimationSettings, channels: ChannelLimits
) -> str:
    """Why the automatic tare is not taken though readings are there; else empty."""
    unloaded = state.unloaded
    if not unloaded.automatic:
        return ""
    enough = len(unloaded.readings) >= settings.tare_samples
    return (refusal(unloaded, settings, channels) if enough else "") or state.tare_problem


class ForceKnown:
    """How well a push would be known after a move to another pose."""

    def __init__(
        self, machine: FeltMachine, law: Law, contacts: Callable[[], ReferenceContacts]
    ) -> None:
        """`contacts` finds the machine at rest under the pushes, when first asked."""
        self._contacts = contacts
        self._law = law
        self._calibrator = Calibrator(machine, law)
        self._last: tuple[Calibration, KnownForce | None] | None = None

    def by(self, calibration: Calibration) -> KnownForce | None:
        """By a calibration; None where the machine bears no such push."""
        if self._last is None or not _same(self._last[0], calibration):
            self._last = calibration, self._known_by(calibration)
        return self._last[1]

    def _known_by(self, calibration: Calibration) -> KnownForce | None:
        try:
            contacts = self._reference_contacts
        except CableSenseError:  # the machine bears no such push
            return None
        moved = self._calibrator.moved(calibration)
        return contacts.known_force(self._law, moved.mean, moved.covariance)

    @cached_property
    def _reference_contacts(self) -> ReferenceContacts:
        return self._contacts()


def _same(one: Calibration, other: Calibration) -> bool:
    same_mean = np.array_equal(one.mean, other.mean)
    return same_mean and np.array_equal(one.covariance, other.covariance)


def tare_status(state: EstimationState, awaited: str, known_force: KnownForce | None) -> Status:
    """How well the unloaded arm is known.

    `awaited` is why no automatic tare is taken (`awaited_tare`), `known_force` as `ForceKnown` has
    it.
    """
    unloaded = state.unloaded
    if isinstance(unloaded, CalibratedState):
        return _calibration_status(unloaded, awaited, known_force)
    since = utc_text(unloaded.tares[-1].unloaded.taken_ns) if unloaded.tares else ""
    return _known_status(unloaded, awaited, f"tared since {since}", {})


def _calibration_status(
    unloaded: CalibratedState, awaited: str, known_force: KnownForce | None
) -> Status:
    calibration = unloaded.calibration
    values = {
        "calibrated by": calibration.made_from,
        "unloaded readings": str(len(calibration.unloaded)),
        "misfit probability": f"{calibration.misfit_probability:.3g}",
    }
    message = f"known by {calibration.made_from}"
    if tares := len(unloaded.tares):
        message += f" and {tares} tare{'s' * (tares > 1)}"
    if known_force is not None:
        values["force known to (N)"] = f"{known_force.half_interval_n:.3f}"
        message += f": {known_force.text}"
    status = _known_status(unloaded, awaited, message, values)
    if status.level is Level.OK and not calibration.as_described:
        return Status(
            "tare",
            Level.WARN,
            "the unloaded readings do not fit the tolerances of its file: it is not as "
            "described, or was touched; enlarge its tolerances, or diagnose it",
            values,
        )
    return status


def _known_status(
    unloaded: UnloadedState[Any], awaited: str, message: str, values: dict[str, str]
) -> Status:
    if not unloaded.known:
        message = "call ~/tare with the arm unloaded"
        if unloaded.automatic:
            message = f"auto_tare waits: {awaited or 'too few readings at rest yet'}"
        return Status("tare", Level.WARN, f"none taken: no estimate; {message}")
    if unloaded.tares:
        last = unloaded.tares[-1].unloaded
        values |= {
            "tared since": utc_text(last.taken_ns),
            "readings averaged": str(last.count),
            "tares that can be undone": str(unloaded.undoable),
        }
    return Status("tare", Level.OK, message, values)
