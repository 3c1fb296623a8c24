"""The demo of the estimator: scripted pushes on the simulated arm, true against estimated."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from rich.table import Table

from cablesense_base.arrays import Array
from cablesense_base.errors import CableSenseError
from cablesense_msgs_py.messages import Level
from cablesense_online.page.live_arm import Contact, LiveArm, Snapshot, angle_error_deg
from cablesense_ros.arm_client import ArmClient, Observer, record
from cablesense_sim.arm import Arm

PUSH_S = 3.0
"""How long each push is held; the pause before it is as long as what is left of its share."""
SHORTEST_SLOT_S = 4.0
MOVE_S = 3.0
"""What a move of the joints may take until the arm rests again."""
WEAKEST_N, STRONGEST_N = 5.0, 120.0
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


class PushObserver(Observer):
    """Pushes and commands the arm, and watches arm and estimator."""

    def __init__(self, arm: Arm) -> None:
        super().__init__()
        self.live = LiveArm(arm, joint_speed_rad_s=JOINT_SPEED_RAD_S)
        self.client = ArmClient(self.node, arm, self.live, "estimator")

    def snapshot(self) -> Snapshot:
        """What is known now."""
        return self.live.snapshot(time.monotonic())


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
        return np.array([one.status.level is not Level.STALE for one in self.snapshots])


def play_script(
    observer: PushObserver,
    script: Sequence[ScriptedPush],
    check: Callable[[], object],
    progress: Callable[[float], object],
) -> PushRecord:
    """Play the script in real time.

    Args:
        observer: pushes and watches.
        script: what to do when.
        check: called at every step; raises to end the play.
        progress: takes the seconds since the start.
    """
    todo = _events(observer.client, script)

    def moment(now_s: float) -> Snapshot:
        while todo and todo[0][0] <= now_s:
            todo.pop(0)[1]()
        progress(now_s)
        return observer.snapshot()

    times, snapshots = record(moment, script[-1].end_s, check)
    observer.client.push(script[-1].segment, 0.0, 0.0)
    return PushRecord(times, snapshots)


def _events(
    client: ArmClient, script: Sequence[ScriptedPush]
) -> list[tuple[float, Callable[[], None]]]:
    events: list[tuple[float, Callable[[], None]]] = []
    before = np.zeros_like(script[0].command_rad)
    for push in script:
        if not np.array_equal(push.command_rad, before):
            events.append((push.move_s, partial(client.command, push.command_rad)))
            before = push.command_rad
        press = partial(client.push, push.segment, push.angle_deg, push.magnitude_n)
        events.append((push.start_s, press))
        events.append((push.end_s, partial(client.push, push.segment, 0.0, 0.0)))
    return sorted(events, key=lambda event: event[0])


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


def push_results(script: Sequence[ScriptedPush], record: PushRecord) -> list[PushResult]:
    """The result of every push."""
    estimated = record.estimated
    results = []
    for push in script:
        steady = (record.times_s >= push.start_s + SETTLING_S) & (
            record.times_s < push.end_s - 0.1
        )
        at = np.flatnonzero(steady & estimated).tolist()
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


def metrics(results: Sequence[PushResult]) -> dict[str, Any]:
    """Everything that the table shows, as plain values."""
    return {
        "summary": summary(results),
        "pushes": [
            {
                "true": _plain(r.push),
                "estimated": None if r.estimate is None else _plain(r.estimate),
                "samples": r.sample_count,
            }
            for r in results
        ],
    }


def _plain(push: ScriptedPush | Contact) -> dict[str, float]:
    return {"segment": push.segment, "angle_deg": push.angle_deg, "magnitude_n": push.magnitude_n}


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
    table.add_column("direction\nerror", justify="right", footer=_number(direction, "°"))
    table.add_column("force\nerror", justify="right", footer=_number(force, " N"))
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
        _number(result.angle_error_deg, "°"),
        _number(result.magnitude_error_n, " N", signed=True),
    )


def _contact(segment: int, angle_deg: float, magnitude_n: float) -> str:
    return f"{segment} {angle_deg:6.1f}° {magnitude_n:6.1f} N"


def _number(value: float | None, unit: str, signed: bool = False) -> str:
    if value is None:
        return "–"
    return f"{value:+.2f}{unit}" if signed else f"{value:.2f}{unit}"
