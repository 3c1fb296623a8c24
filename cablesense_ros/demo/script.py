"""The script of a headless demo: which pushes, at which poses, and when.

What a headless demo found: each push, true against estimated, and the record over time.

The table of a headless demo: every push, true against estimated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from cablesense_base.errors import CableSenseError
from cablesense_online.page.snapshot import Contact, Snapshot, angle_error_deg

PUSH_S = 3.0
"""How long each push is held; the pause before it is as long as what is left of its share."""
SHORTEST_SLOT_S = 4.0
MOVE_S = 3.0
"""What a move of the joints and the arm's coming to rest may take."""
WEAKEST_N, STRONGEST_N = 5.0, 120.0
POSE_LIMIT_DEG = 8.0


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
    command_rad: NDArray[np.float64]
    move_s: float


def make_script(segment_count: int, duration_s: float, seed: int) -> list[ScriptedPush]:
    """Pushes on one segment after another: at the straight arm first, then at random poses.

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
        magnitude = WEAKEST_N * (STRONGEST_N / WEAKEST_N) ** rng.random()
        script.append(
            ScriptedPush(
                start_s=now_s + slot_s - PUSH_S,
                end_s=now_s + slot_s,
                segment=1 + number % segment_count,
                angle_deg=float(rng.uniform(0.0, 360.0)),
                magnitude_n=float(round(magnitude, 1)),
                command_rad=command,
                move_s=now_s,
            )
        )
        now_s += slot_s
    return script


SETTLING_S = 1.0
"""The first second of a push does not count: the arm swings and the estimate follows."""


@dataclass(frozen=True)
class PushResult:
    """One push and the estimate of it, the median over its steady part.

    Attributes:
        push: as scripted.
        estimate: None when nothing was reported for most of it.
        sample_count: steady moments looked at; 0 when no estimates came.
    """

    push: ScriptedPush
    estimate: Contact | None
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


@dataclass(frozen=True)
class Record:
    """A headless demo from start to end: snapshots, and their times since the start."""

    times_s: NDArray[np.float64]
    snapshots: Sequence[Snapshot]
    heard: NDArray[np.bool_]
    """Whether an estimate was there at each moment, be it of no contact."""


def push_results(script: Sequence[ScriptedPush], record: Record) -> list[PushResult]:
    """The result of every push."""
    results = []
    for push in script:
        steady = (record.times_s >= push.start_s + SETTLING_S) & (
            record.times_s < push.end_s - 0.1
        )
        at = np.flatnonzero(steady & record.heard).tolist()
        contacts = [record.snapshots[i].estimate for i in at]
        results.append(PushResult(push, _median(contacts), len(at)))
    return results


def _median(contacts: Sequence[Contact | None]) -> Contact | None:
    segments = [contact.segment if contact else 0 for contact in contacts]
    if not segments:
        return None
    usual = max(set(segments), key=segments.count)
    same = [contact for contact in contacts if contact is not None and contact.segment == usual]
    if usual == 0:
        return None
    angles = np.deg2rad([contact.angle_deg for contact in same])
    angle = np.rad2deg(np.arctan2(np.median(np.sin(angles)), np.median(np.cos(angles)))) % 360.0
    force = np.median([contact.force_base_n for contact in same], axis=0)
    return Contact(usual, float(angle), float(np.median([c.magnitude_n for c in same])), force)


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


def as_json(results: Sequence[PushResult]) -> dict[str, Any]:
    """Everything that the table shows, for machines."""
    return {
        "summary": summary(results),
        "pushes": [
            {
                "true": {
                    "segment": r.push.segment,
                    "angle_deg": r.push.angle_deg,
                    "magnitude_n": r.push.magnitude_n,
                },
                "estimated": None
                if r.estimate is None
                else {
                    "segment": r.estimate.segment,
                    "angle_deg": r.estimate.angle_deg,
                    "magnitude_n": r.estimate.magnitude_n,
                },
                "samples": r.sample_count,
            }
            for r in results
        ],
    }


def results_table(results: Sequence[PushResult]) -> Table:
    """One row for each push, mean errors in the footer."""
    found = summary(results)
    direction, force = found["direction_mae_deg"], found["magnitude_mae_n"]
    table = Table(title="True against estimated", show_footer=True, title_justify="left")
    table.add_column("pose", footer="mean")
    table.add_column("true segment,\ndirection, force", justify="right", no_wrap=True)
    right = f"{found['segment_right']} of {found['pushes']} right"
    table.add_column(
        "estimated segment,\ndirection, force", justify="right", no_wrap=True, footer=right
    )
    table.add_column("direction\nerror", justify="right", footer=_figure(direction, "°"))
    table.add_column("force\nerror", justify="right", footer=_figure(force, " N"))
    for result in results:
        table.add_row(*_row(result))
    return table


def _row(result: PushResult) -> tuple[str, ...]:
    push, estimate = result.push, result.estimate
    mark = "green" if result.segment_right else "red"
    if estimate is not None:
        found = _contact(estimate.segment, estimate.angle_deg, estimate.magnitude_n)
    else:
        found = "no contact" if result.sample_count else "no estimate"
    return (
        "bent" if push.command_rad.any() else "straight",
        _contact(push.segment, push.angle_deg, push.magnitude_n),
        f"[{mark}]{found}[/]",
        _figure(result.angle_error_deg, "°"),
        _figure(result.magnitude_error_n, " N", signed=True),
    )


def _contact(segment: int, angle_deg: float, magnitude_n: float) -> str:
    return f"{segment} {angle_deg:6.1f}° {magnitude_n:6.1f} N"


def _figure(value: float | None, unit: str, signed: bool = False) -> str:
    if value is None:
        return "–"
    return f"{value:+.2f}{unit}" if signed else f"{value:.2f}{unit}"
