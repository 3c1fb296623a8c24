"""Scripted pushes on the simulated arm, played and compared with the estimates of them."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_msgs_py.messages import NO_CONTACT, Contact
from cablesense_online.page.live_arm import LiveArm
from cablesense_online.page.score import angle_error_deg
from cablesense_online.page.snapshot import KnownMoment, ShownContact, Snapshot
from cablesense_ros.arm_client import ArmClient, record
from cablesense_sim.load_capacity import USUAL_CONTACT_N

PUSH_S = 3.0
"""Each push is held this long. A pause before it fills its slot."""
SHORTEST_SLOT_S = 4.0
MOVE_S = 3.0
"""A move of the joints may take this long until the arm rests again."""
WEAKEST, STRONGEST = 0.025, 0.6
"""Pushes, as shares of the strongest contact that the arm's networks learn."""
MOST_ALONG = 0.2
"""Largest axial part, as a share of the normal force: below the friction of most surfaces."""
POSE_LIMIT_DEG = 8.0
SETTLING_S = 1.0
"""The first second of a push does not count: the arm swings and the estimate follows."""


class ScriptError(CableSenseError):
    """A demo of a length that holds no push."""


@dataclass(frozen=True)
class ScriptedPush:
    """One push of the script.

    Attributes:
        start_s, end_s: since the start of the script.
        contact: what pushes where, at the commanded pose.
        command_rad: (2N,) joint angles commanded at `move_s`, before the push.
        move_s: since the start of the script.
    """

    start_s: float
    end_s: float
    contact: Contact
    command_rad: Array
    move_s: float


def make_script(
    reach_m: Array,
    duration_s: float,
    seed: int,
    range_n: float = USUAL_CONTACT_N,
    most_along: float = MOST_ALONG,
) -> list[ScriptedPush]:
    """Pushes on one segment after another, the last first: the straight arm, then random poses.

    They act within `reach_m` (N, 2) of each segment, from its joint centre, with up to 0.6 of
    `range_n`, the strongest contact to expect, and `most_along` of their force along the axis.

    Raises:
        ScriptError: the duration is too short for one push.
    """
    if not duration_s >= SHORTEST_SLOT_S:
        raise ScriptError(
            f"duration is {duration_s:g} s; one push takes {SHORTEST_SLOT_S:g} s at least"
        )
    rng, segment_count = np.random.default_rng(seed), len(reach_m)
    straight_count = max(1, int(0.5 * duration_s / SHORTEST_SLOT_S))
    posed_count = int((duration_s - straight_count * SHORTEST_SLOT_S) / (SHORTEST_SLOT_S + MOVE_S))
    script = []
    now_s = 0.0
    for number in range(straight_count + posed_count):
        command = np.zeros(2 * segment_count)
        end_s = now_s + SHORTEST_SLOT_S
        if number >= straight_count:
            command = np.deg2rad(rng.uniform(-POSE_LIMIT_DEG, POSE_LIMIT_DEG, 2 * segment_count))
            end_s += MOVE_S
        magnitude_n = range_n * WEAKEST * (STRONGEST / WEAKEST) ** rng.random()
        segment = segment_count - number % segment_count
        contact = Contact(
            segment=segment,
            angle_deg=float(rng.uniform(0.0, 360.0)),
            magnitude_n=float(f"{magnitude_n:.3g}"),
            contact_m=float(rng.uniform(*reach_m[segment - 1])),
            along_n=float(magnitude_n * rng.uniform(-most_along, most_along)),
        )
        script.append(
            ScriptedPush(
                start_s=end_s - PUSH_S,
                end_s=end_s,
                contact=contact,
                command_rad=command,
                move_s=now_s,
            )
        )
        now_s = end_s
    return script


class PushRecord(NamedTuple):
    """Snapshots at K moments, and their times (K,) since the start of the script."""

    times_s: Array
    snapshots: Sequence[Snapshot]


def play_script(
    client: ArmClient,
    live: LiveArm,
    script: Sequence[ScriptedPush],
    check: Callable[[], object],
    progress: Callable[..., object],
) -> PushRecord:
    """Play the script in real time.

    At every step `check` is called, which raises to end the play, and `progress` with the seconds
    since the start as `completed`.
    """
    due: deque[tuple[float, Callable[[], None]]] = deque()
    for push in script:
        press = partial(client.push, push.contact)
        if push.command_rad.any():
            due.append((push.move_s, partial(client.command, push.command_rad)))
        due.append((push.start_s, press))
        due.append((push.end_s, partial(client.push, NO_CONTACT)))

    def moment(now_s: float) -> Snapshot:
        while due and due[0][0] <= now_s:
            due.popleft()[1]()
        progress(completed=now_s)
        return live.snapshot(time.monotonic())

    played = record(moment, script[-1].end_s, check)
    client.push(NO_CONTACT)
    return PushRecord(*played)


Seen = ShownContact | KnownMoment
"""An estimated contact: its force and place, or the moment alone."""


@dataclass(frozen=True)
class PushResult:
    """One push and the estimate of it, the median over its steady part.

    Attributes:
        push: as scripted.
        estimate: None when nothing was reported for most of it.
        sample_count: steady moments looked at; 0 when no estimates came.
    """

    push: ScriptedPush
    estimate: Seen | None
    sample_count: int

    @property
    def segment_right(self) -> bool:
        """Whether the push was found on the segment where it was; without it are no errors."""
        found = self.estimate
        return found is not None and found.segment == self.push.contact.segment

    @property
    def angle_error_deg(self) -> float | None:
        """Of the direction."""
        found = self.estimate if self.segment_right else None
        if found is None:
            return None
        return angle_error_deg(found.angle_deg, self.push.contact.angle_deg)

    @property
    def place_error_mm(self) -> float | None:
        """Estimated minus true place; None where the moment alone is known."""
        found = self._located
        return None if found is None else 1e3 * (found.contact_m - self.push.contact.contact_m)

    @property
    def magnitude_error_n(self) -> float | None:
        """Estimated minus true normal force; None where the moment alone is known."""
        found = self._located
        return None if found is None else found.magnitude_n - self.push.contact.magnitude_n

    @property
    def moment_error_n_m(self) -> float | None:
        """Estimated minus true moment about the joint, where that alone is known."""
        found, true = self.estimate, self.push.contact
        if not self.segment_right or not isinstance(found, KnownMoment):
            return None
        return found.moment_n_m - true.contact_m * true.magnitude_n

    @property
    def _located(self) -> ShownContact | None:
        found = self.estimate
        return found if self.segment_right and isinstance(found, ShownContact) else None


def seen(now: Snapshot) -> Seen | None:
    """The estimate of the strongest contact."""
    return now.moment or next(iter(now.estimated), None)


def push_results(script: Sequence[ScriptedPush], played: PushRecord) -> list[PushResult]:
    """The result of every push."""
    results = []
    for push in script:
        steady = (played.times_s >= push.start_s + SETTLING_S) & (
            played.times_s < push.end_s - 0.1
        )
        moments = [played.snapshots[i] for i in np.flatnonzero(steady).tolist()]
        found = [seen(now) for now in moments if now.answered]
        results.append(PushResult(push, _median(found), len(found)))
    return results


def _median(found: Sequence[Seen | None]) -> Seen | None:
    """The median of the most frequent kind on its segment; None where that is no contact."""
    kinds = [(type(each), each.segment if each else 0) for each in found]
    usual = max(set(kinds), key=kinds.count, default=None)
    same = [each for each, kind in zip(found, kinds, strict=True) if each and kind == usual]
    if not same:
        return None
    turn = np.exp(1j * np.deg2rad([each.angle_deg for each in same]))
    middle = np.median(turn.real) + 1j * np.median(turn.imag)
    segment, angle_deg = same[0].segment, float(np.angle(middle, deg=True) % 360.0)
    moments = [each.moment_n_m for each in same if isinstance(each, KnownMoment)]
    if moments:
        return KnownMoment(segment, angle_deg, float(np.median(moments)))
    contacts = [each for each in same if isinstance(each, ShownContact)]
    return ShownContact(
        segment,
        angle_deg,
        float(np.median([each.magnitude_n for each in contacts])),
        float(np.median([each.contact_m for each in contacts])),
        float(np.median([each.along_n for each in contacts])),
        np.median([each.force_base_n for each in contacts], axis=0),
    )


def summary(results: Sequence[PushResult]) -> dict[str, Any]:
    """Mean errors over the pushes found on their segment; None where there are none."""

    def mean(errors: Iterable[float | None]) -> float | None:
        known = [abs(error) for error in errors if error is not None]
        return float(np.mean(known)) if known else None

    return {
        "pushes": len(results),
        "estimated": sum(result.sample_count > 0 for result in results),
        "segment_right": sum(result.segment_right for result in results),
        "place_mae_mm": mean(result.place_error_mm for result in results),
        "direction_mae_deg": mean(result.angle_error_deg for result in results),
        "magnitude_mae_n": mean(result.magnitude_error_n for result in results),
        "moment_mae_n_m": mean(result.moment_error_n_m for result in results),
    }
