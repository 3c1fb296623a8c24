"""The demo of the estimator: scripted pushes on the simulated arm, true against estimated."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from rich.table import Table

from cablesense_base import Array, CableSenseError
from cablesense_online.page.live_arm import LiveArm, ShownContact, Snapshot
from cablesense_online.page.score import angle_error_deg
from cablesense_ros.arm_client import ArmClient, record
from cablesense_sim.load_capacity import USUAL_CONTACT_N

PUSH_S = 3.0
"""How long each push is held; the pause before it is as long as what is left of its share."""
SHORTEST_SLOT_S = 4.0
MOVE_S = 3.0
"""What a move of the joints may take until the arm rests again."""
WEAKEST, STRONGEST = 0.025, 0.6
"""Pushes, as shares of the strongest contact that the arm's networks learn."""
POSE_LIMIT_DEG = 8.0
JOINT_SPEED_RAD_S = float(np.deg2rad(20.0))
SETTLING_S = 1.0
"""The first second of a push does not count: the arm swings and the estimate follows."""


class ScriptError(CableSenseError):
    """A demo of a length that holds no push."""


@dataclass(frozen=True)
class ScriptedPush:
    """One push of the script.

    Attributes:
        start_s, end_s: since the start of the script.
        segment: 1 … N.
        angle_deg: from the segment's +z towards its +y, at the commanded pose.
        magnitude_n: newtons.
        command_rad: (2N,) joint angles commanded at `move_s`, before the push.
        move_s: since the start of the script.
    """

    start_s: float
    end_s: float
    segment: int
    angle_deg: float
    magnitude_n: float
    command_rad: Array
    move_s: float


def make_script(
    segment_count: int, duration_s: float, seed: int, range_n: float = USUAL_CONTACT_N
) -> list[ScriptedPush]:
    """Pushes on one segment after another: at the straight arm first, then at random poses.

    `range_n` is the strongest contact to expect of the arm.

    Raises:
        ScriptError: the duration is too short for one push.
    """
    if not duration_s >= SHORTEST_SLOT_S:
        raise ScriptError(
            f"duration is {duration_s:g} s; one push takes {SHORTEST_SLOT_S:g} s at least"
        )
    rng = np.random.default_rng(seed)
    straight_count = max(1, int(0.5 * duration_s / SHORTEST_SLOT_S))
    posed_count = int((duration_s - straight_count * SHORTEST_SLOT_S) / (SHORTEST_SLOT_S + MOVE_S))
    script = []
    now_s = 0.0
    for number in range(straight_count + posed_count):
        posed = number >= straight_count
        command = np.zeros(2 * segment_count)
        slot_s = SHORTEST_SLOT_S
        if posed:
            command = np.deg2rad(rng.uniform(-POSE_LIMIT_DEG, POSE_LIMIT_DEG, 2 * segment_count))
            slot_s += MOVE_S
        magnitude = range_n * WEAKEST * (STRONGEST / WEAKEST) ** rng.random()
        script.append(
            ScriptedPush(
                start_s=now_s + slot_s - PUSH_S,
                end_s=now_s + slot_s,
                segment=1 + number % segment_count,
                angle_deg=float(rng.uniform(0.0, 360.0)),
                magnitude_n=float(f"{magnitude:.3g}"),
                command_rad=command,
                move_s=now_s,
            )
        )
        now_s += slot_s
    return script


@dataclass(frozen=True)
class PushRecord:
    """K moments.

    Attributes:
        times_s: (K,) since the start.
        snapshots: (K,) what was known.
    """

    times_s: Array
    snapshots: Sequence[Snapshot]

    @property
    def estimated(self) -> np.ndarray:
        """(K,) whether an estimate was there, be it of no contact."""
        return np.array([one.answered for one in self.snapshots])


def play_script(
    client: ArmClient,
    live: LiveArm,
    script: Sequence[ScriptedPush],
    check: Callable[[], object],
    progress: Callable[..., object],
) -> PushRecord:
    """Play the script in real time.

    Args:
        client: pushes and commands the arm.
        live: what is known of it.
        script: what to do when.
        check: called at every step; raises to end the play.
        progress: takes the seconds since the start, as `completed`.
    """
    due: deque[tuple[float, Callable[[], None]]] = deque()
    pose = np.zeros_like(script[0].command_rad)
    for push in script:
        if not np.array_equal(push.command_rad, pose):
            pose = push.command_rad
            due.append((push.move_s, partial(client.command, pose)))
        press = partial(client.push, push.segment, push.angle_deg, push.magnitude_n)
        due.append((push.start_s, press))
        due.append((push.end_s, partial(client.push, push.segment, 0.0, 0.0)))

    def moment(now_s: float) -> Snapshot:
        while due and due[0][0] <= now_s:
            due.popleft()[1]()
        progress(completed=now_s)
        return live.snapshot(time.monotonic())

    times, snapshots = record(moment, script[-1].end_s, check)
    client.push(script[-1].segment, 0.0, 0.0)
    return PushRecord(times, snapshots)


@dataclass(frozen=True)
class PushResult:
    """One push and the estimate of it, the median over its steady part.

    Attributes:
        push: as scripted.
        estimate: None when nothing was reported for most of it.
        sample_count: steady moments looked at; 0 when no estimates came.
    """

    push: ScriptedPush
    estimate: ShownContact | None
    sample_count: int

    @property
    def segment_right(self) -> bool:
        """Whether the push was found on the segment where it was."""
        return self.estimate is not None and self.estimate.segment == self.push.segment

    @property
    def angle_error_deg(self) -> float | None:
        """Error of the direction, where the segment is right."""
        if self.estimate is None or not self.segment_right:
            return None
        return angle_error_deg(self.estimate.angle_deg, self.push.angle_deg)

    @property
    def magnitude_error_n(self) -> float | None:
        """Estimated minus true force, where the segment is right."""
        if self.estimate is None or not self.segment_right:
            return None
        return self.estimate.magnitude_n - self.push.magnitude_n


def push_results(script: Sequence[ScriptedPush], record: PushRecord) -> list[PushResult]:
    """The result of every push."""
    results = []
    for push in script:
        since, until = push.start_s + SETTLING_S, push.end_s - 0.1
        steady = (record.times_s >= since) & (record.times_s < until)
        at = np.flatnonzero(steady & record.estimated).tolist()
        contacts = [record.snapshots[i].estimate for i in at]
        results.append(PushResult(push, _median(contacts), len(at)))
    return results


def _median(contacts: Sequence[ShownContact | None]) -> ShownContact | None:
    """Of those on the segment that most are on; None where most are of no contact."""
    segments = [contact.segment if contact else 0 for contact in contacts]
    usual = max(set(segments), key=segments.count, default=0)
    if usual == 0:
        return None
    same = [contact for contact in contacts if contact is not None and contact.segment == usual]
    angles = np.deg2rad([contact.angle_deg for contact in same])
    angle = np.rad2deg(np.arctan2(np.median(np.sin(angles)), np.median(np.cos(angles)))) % 360.0
    force = np.median([contact.force_base_n for contact in same], axis=0)
    return ShownContact(
        usual, float(angle), float(np.median([c.magnitude_n for c in same])), force
    )


def summary(results: Sequence[PushResult]) -> dict[str, Any]:
    """Mean errors over all pushes; None where none was found on its segment."""
    angles = [r.angle_error_deg for r in results if r.angle_error_deg is not None]
    forces = [abs(r.magnitude_error_n) for r in results if r.magnitude_error_n is not None]
    return {
        "pushes": len(results),
        "estimated": sum(1 for r in results if r.sample_count),
        "segment_right": sum(1 for r in results if r.segment_right),
        "direction_mae_deg": float(np.mean(angles)) if angles else None,
        "magnitude_mae_n": float(np.mean(forces)) if forces else None,
    }


def metrics(results: Sequence[PushResult]) -> dict[str, Any]:
    """Everything that the table shows, as plain values."""

    def plain(contact: ScriptedPush | ShownContact) -> dict[str, float]:
        return {name: getattr(contact, name) for name in ("segment", "angle_deg", "magnitude_n")}

    return {
        "summary": summary(results),
        "pushes": [
            {
                "true": plain(r.push),
                "estimated": plain(r.estimate) if r.estimate else None,
                "samples": r.sample_count,
            }
            for r in results
        ],
    }


def results_table(results: Sequence[PushResult]) -> Table:
    """One row for each push, mean errors in the footer."""
    mean = summary(results)
    right = f"{mean['segment_right']} of {mean['pushes']} right"
    table = Table(title="True against estimated", show_footer=True, title_justify="left")
    table.add_column("pose", footer="mean")
    for name, footer in (("true", ""), ("estimated", right)):
        table.add_column(
            f"{name} segment,\ndirection, force", footer, justify="right", no_wrap=True
        )
    for name, value, unit in (
        ("direction", mean["direction_mae_deg"], "°"),
        ("force", mean["magnitude_mae_n"], " N"),
    ):
        table.add_column(f"{name}\nerror", justify="right", footer=_number(value, ".2f", unit))
    for r in results:
        missing = "no contact" if r.sample_count else "no estimate"
        found = _contact(r.estimate) if r.estimate else missing
        table.add_row(
            "bent" if r.push.command_rad.any() else "straight",
            _contact(r.push),
            f"[{'green' if r.segment_right else 'red'}]{found}[/]",
            _number(r.angle_error_deg, ".2f", "°"),
            _number(r.magnitude_error_n, "+.2f", " N"),
        )
    return table


def _contact(contact: ScriptedPush | ShownContact) -> str:
    return f"{contact.segment} {contact.angle_deg:6.1f}° {contact.magnitude_n:6.1f} N"


def _number(value: float | None, form: str, unit: str) -> str:
    return "–" if value is None else f"{value:{form}}{unit}"
