"""The estimator's health in diagnostics: its input, cables, pose, tare and model."""

from __future__ import annotations

from collections import Counter

import numpy as np

from cablesense_msgs_py.diagnostics import Level, Status
from cablesense_online.models import LoadedModel
from cablesense_online.motion_gate import MotionGate
from cablesense_online.samples import ProblemKind, SampleCheck, SampleClock, SampleError
from cablesense_online.tare import Tares, time_text


class InputHealth:
    """Counts samples between reports; totals go on."""

    def __init__(self, clock: SampleClock, now_s: float) -> None:
        """From monotonic time `now_s` on; ages and missing samples are those of `clock`."""
        self._clock = clock
        clock.largest_age_s = 0.0
        self._report_s = now_s
        self._arrived = 0
        self._refused: Counter[ProblemKind] = Counter()
        self._last_problem = ""
        self._total_missing = 0
        self._total_refused = 0
        self._last_arrival_s = now_s
        self._received = False

    def arrived(self, now_s: float) -> None:
        """A message came, whatever is in it."""
        self._arrived += 1
        self._received = True
        self._last_arrival_s = now_s

    def refused(self, problem: SampleError) -> None:
        """A sample could not be used."""
        self._refused[problem.kind] += 1
        self._last_problem = str(problem)
        self._total_refused += 1

    def silence_s(self, now_s: float) -> float:
        """Time since the last message, or since the start before the first."""
        return now_s - self._last_arrival_s

    def status(self, now_s: float, lost: int, publisher_count: int) -> Status:
        """The report of the time since the last one.

        Args:
            now_s: monotonic time.
            lost: samples that the middleware reported as lost since the last report.
            publisher_count: publishers on the topic.
        """
        missing = max(lost, self._clock.missing_since_last_report())
        self._total_missing += missing
        rate = self._arrived / max(now_s - self._report_s, 1e-9)
        level, message = self._verdict(now_s, missing, publisher_count)
        values = {
            "rate (Hz)": f"{rate:.1f}",
            "largest age (s)": f"{self._clock.largest_age_s:.4f}",
            "dropped": str(missing),
            "dropped in all": str(self._total_missing),
            "refused": str(sum(self._refused.values())),
            "refused in all": str(self._total_refused),
            "publishers": str(publisher_count),
        }
        values |= {f"refused: {kind.value}": str(count) for kind, count in self._refused.items()}
        if self._last_problem:
            values["last refusal"] = self._last_problem
        self._report_s, self._arrived, self._clock.largest_age_s = now_s, 0, 0.0
        self._refused.clear()
        return Status("cable_tensions", level, message, values)

    def _verdict(self, now_s: float, missing: int, publisher_count: int) -> tuple[Level, str]:
        silence = self.silence_s(now_s)
        if not self._received:
            return Level.STALE, "no sample received yet"
        if silence > self._clock.stale_after_s:
            return Level.STALE, f"no sample for {silence:.1f} s"
        if self._refused:
            kinds = ", ".join(f"{count} {kind.value}" for kind, count in self._refused.items())
            return Level.ERROR, f"samples refused: {kinds}"
        if publisher_count > 1:
            return Level.WARN, f"{publisher_count} publishers; one arm has one"
        if missing:
            return Level.WARN, f"{missing} sample{'s' if missing != 1 else ''} dropped"
        return Level.OK, "receiving"


def cable_status(check: SampleCheck) -> Status:
    """Which cables are slack. The estimate goes on: statics holds with slack cables too."""
    names = ", ".join(f"cable_{number}" for number in check.slack) or "none"
    level, message = (
        (Level.WARN, f"slack: {names}") if check.slack else (Level.OK, "all cables taut")
    )
    values = {"slack": names, "slack below (N)": f"{check.slack_below_n:g}"}
    return Status("cables", level, message, values)


def pose_status(
    gate: MotionGate, pose_range_deg: float, refused: int, *, received: bool, in_motion: bool
) -> Status:
    """What is known of the arm's pose.

    Args:
        gate: with the command in force.
        pose_range_deg: the model was trained within ± this.
        refused: commands that were refused since the last report.
        received: whether any command has come.
        in_motion: whether the model estimates while the arm moves.
    """
    command_deg = [float(angle) for angle in np.rad2deg(gate.command_rad)]
    values = {
        "commands refused": str(refused),
        "command (deg)": ", ".join(f"{angle:.2f}" for angle in command_deg),
    }
    level, message = Level.OK, "at rest"
    if refused:
        level, message = Level.ERROR, "a command was refused; see the log"
    elif gate.shut:
        message = "moving" if in_motion else "moving: no estimate until the arm rests"
    elif max(map(abs, command_deg)) > pose_range_deg + 1e-6:
        level = Level.WARN
        message = f"beyond the poses that the model was trained on (±{pose_range_deg:g} degrees)"
    elif not received:
        level, message = Level.WARN, "none received: arm taken to be straight"
    return Status("joint_commands", level, message, values)


def tare_status(tares: Tares) -> Status:
    """Whether there is a tare, since when, and how far it lies from the arm's model."""
    tare = tares.present
    if tare is None:
        return Status(
            "tare", Level.WARN, "none taken: no estimate; call ~/tare with the arm unloaded"
        )
    since = time_text(tare.taken_ns)
    values = {
        "tared since": since,
        "readings averaged": str(tare.sample_count),
        "largest deviation from the arm file (N)": f"{tare.offset_n:.2f}",
        "unloaded tensions (N)": ", ".join(f"{tension:.2f}" for tension in tare.measured_n),
        "tares that can be undone": str(tares.undoable),
    }
    return Status("tare", Level.OK, f"tared since {since}", values)


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
    level, message = Level.OK, "active"
    if not active:
        level, message = Level.WARN, "configured, not active"
    elif largest_force_n > metadata.force_range_n:
        level, message = Level.WARN, "forces beyond those it was trained on"
    return Status("model", level, message, values)
