"""Scripted pushes on the simulated arm, played and compared with the estimates of them.

The report is a table, plain values, and a picture.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from cablesense_base import Array, CableSenseError
from cablesense_base.files import written_whole
from cablesense_msgs_py.messages import NO_CONTACT, Contact
from cablesense_online.page.live_arm import LiveArm
from cablesense_online.page.snapshot import (
    ESTIMATE_RGB,
    SETTLING_S,
    TRUE_RGB,
    Snapshot,
    angle_error_deg,
    css,
)
from cablesense_ros.arm_client import ArmClient
from cablesense_sim.load_capacity import USUAL_CONTACT_N

PUSH_S, SHORTEST_SLOT_S = 3.0, 4.0
"""Each push is held this long. A pause before it fills its slot."""
MOVE_S = 3.0
"""A move of the joints may take this long until the arm rests again."""
WEAKEST, STRONGEST = 0.025, 0.6
"""Pushes, as shares of the strongest contact that the arm's networks learn."""
MOST_ALONG = 0.2
"""Largest axial part, as a share of the normal force: below the friction of most surfaces."""
POSE_LIMIT_DEG = 8.0
_RECORD_EVERY_S = 0.04
_LOCATED = ("magnitude_n", "contact_m", "along_n")
"""Not known of a contact of which the moment alone is."""


class ScriptError(CableSenseError):
    """A demo of a length that holds no push."""


@dataclass(frozen=True)
class ScriptedPush:
    """One push of the script; its times are since the start of the script.

    Attributes:
        contact: what pushes where, at the commanded pose.
        command_rad: (2N,) joint angles commanded at `move_s`, before the push.
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
        script.append(ScriptedPush(end_s - PUSH_S, end_s, contact, command, move_s=now_s))
        now_s = end_s
    return script


class PushRecord(NamedTuple):
    """Snapshots at K moments, and their times (K,) since the start of the script, s."""

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
        if push.command_rad.any():
            due.append((push.move_s, partial(client.command, push.command_rad)))
        due.append((push.start_s, partial(client.push, push.contact)))
        due.append((push.end_s, partial(client.push, NO_CONTACT)))
    times_s, snapshots = [], []
    start_s = time.monotonic()
    while (now_s := time.monotonic() - start_s) < script[-1].end_s:
        check()
        while due and due[0][0] <= now_s:
            due.popleft()[1]()
        progress(completed=now_s)
        snapshots.append(live.snapshot(time.monotonic()))
        times_s.append(now_s)
        time.sleep(_RECORD_EVERY_S)
    client.push(NO_CONTACT)
    return PushRecord(np.array(times_s), snapshots)


@dataclass(frozen=True)
class PushResult:
    """One push and the estimate of it, the median over its steady part.

    Attributes:
        estimate: None when nothing was reported for most of it.
        sample_count: steady moments looked at; 0 when no estimates came.
    """

    push: ScriptedPush
    estimate: Contact | None
    sample_count: int

    @property
    def moment_alone(self) -> bool:
        """Whether neither force nor place is known of the estimated contact."""
        return self.estimate is not None and self.estimate.moment_n_m is not None

    @property
    def segment_right(self) -> bool:
        """Whether the push was found on the segment where it was."""
        return self.estimate is not None and self.estimate.segment == self.push.contact.segment

    @property
    def errors(self) -> dict[str, float]:
        """Estimated minus true, by name with unit, of a push found on its segment.

        If only the moment about the joint is known, its error replaces those of place and force.
        """
        found, true = self.estimate, self.push.contact
        if found is None or not self.segment_right:
            return {}
        errors = {"direction_deg": angle_error_deg(found.angle_deg, true.angle_deg)}
        if found.moment_n_m is not None:
            return errors | {"moment_n_m": found.moment_n_m - true.contact_m * true.magnitude_n}
        return errors | {
            "place_mm": 1e3 * (found.contact_m - true.contact_m),
            "magnitude_n": found.magnitude_n - true.magnitude_n,
        }


def seen(now: Snapshot) -> Contact | None:
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


def _median(found: Sequence[Contact | None]) -> Contact | None:
    """The median of the most frequent kind on its segment; None where that is no contact."""
    kinds = [(each.segment, each.moment_n_m is None) if each else None for each in found]
    usual = max(set(kinds), key=kinds.count, default=None)
    same = [each for each, kind in zip(found, kinds, strict=True) if each and kind == usual]
    if not same:
        return None
    turn = np.exp(1j * np.deg2rad([each.angle_deg for each in same]))
    middle = np.median(turn.real) + 1j * np.median(turn.imag)
    medians = {
        name: float(np.median([getattr(each, name) for each in same]))
        for name in ("magnitude_n", "contact_m", "along_n", "moment_n_m")
        if getattr(same[0], name) is not None
    }
    angle_deg = float(np.angle(middle, deg=True) % 360.0)
    return Contact(same[0].segment, angle_deg, **medians)


def summary(results: Sequence[PushResult]) -> dict[str, Any]:
    """Mean errors over the pushes found on their segment; None where there are none."""

    def mean(name: str) -> float | None:
        known = [abs(result.errors[name]) for result in results if name in result.errors]
        return float(np.mean(known)) if known else None

    return {
        "pushes": len(results),
        "estimated": sum(result.sample_count > 0 for result in results),
        "segment_right": sum(result.segment_right for result in results),
        "place_mae_mm": mean("place_mm"),
        "direction_mae_deg": mean("direction_deg"),
        "magnitude_mae_n": mean("magnitude_n"),
        "moment_mae_n_m": mean("moment_n_m"),
    }


def metrics(results: Sequence[PushResult]) -> dict[str, Any]:
    """Everything that the table shows, as plain values."""

    def plain(contact: Contact) -> dict[str, float]:
        """Force and place, or the moment where that is known alone."""
        unknown = _LOCATED if contact.moment_n_m is not None else ("moment_n_m",)
        return {name: n for name, n in contact._asdict().items() if name not in unknown}

    return {
        "summary": summary(results),
        "pushes": [
            {
                "true": plain(result.push.contact),
                "estimated": plain(result.estimate) if result.estimate else None,
                "samples": result.sample_count,
            }
            for result in results
        ],
    }


def _mean_errors(results: Sequence[PushResult]) -> dict[str, str]:
    """The means that people are shown, by quantity."""
    mean = summary(results)
    return {
        "place": _text("{:.1f} mm", mean["place_mae_mm"]),
        "direction": _text("{:.2f}°", mean["direction_mae_deg"]),
        "force": _text("{:.2f} N", mean["magnitude_mae_n"]),
    }


def results_table(results: Sequence[PushResult]) -> Table:
    """One row for each push, mean errors in the footer."""
    title = "True against estimated: the straight arm, then bent"
    table = Table(title=title, show_footer=True, title_justify="left")
    right = f"{sum(result.segment_right for result in results)} of {len(results)}"
    head = "true segment, place,\ndirection, force"
    table.add_column(head, "segments right, mean errors", justify="right", no_wrap=True)
    table.add_column("estimated\nsegment", right, justify="right")
    for name, mean in _mean_errors(results).items():
        table.add_column(f"{name}\nerror", mean, justify="right")
    straight = sum(not result.push.command_rad.any() for result in results)
    for number, result in enumerate(results, start=1):
        true, errors = result.push.contact, result.errors
        table.add_row(
            f"{true.segment} {1e3 * true.contact_m:4.0f} mm {true.angle_deg:6.1f}° "
            f"{true.magnitude_n:6.1f} N",
            f"[{'green' if result.segment_right else 'red'}]{_found(result)}[/]",
            _text("{:+.1f} mm", errors.get("place_mm")),
            _text("{:.2f}°", errors.get("direction_deg")),
            _text("{:+.2f} N·m", errors.get("moment_n_m"))
            if result.moment_alone
            else _text("{:+.2f} N", errors.get("magnitude_n")),
            end_section=number == straight,
        )
    return table


def _found(result: PushResult) -> str:
    if result.estimate is None:
        return "no contact" if result.sample_count else "no estimate"
    moment = ", moment" if result.moment_alone else ""
    return f"{result.estimate.segment}{moment}"


def _known(contact: Contact, name: str) -> float:
    """A number of a contact; of a moment neither force nor place is known."""
    unknown = contact.moment_n_m is not None and name in _LOCATED
    return np.nan if unknown else float(getattr(contact, name))


def _text(form: str, value: float | None) -> str:
    return "–" if value is None else form.format(value)


def draw_pushes(
    path: Path, played: PushRecord, results: Sequence[PushResult], segment_count: int
) -> None:
    """Draw true and estimated contacts over time, as PNG."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    right = sum(result.segment_right for result in results)
    caption = f"{right} of {len(results)} pushes on the right segment"
    if right:
        means = (f"{name} {mean}" for name, mean in _mean_errors(results).items())
        caption += f"; mean errors: {', '.join(means)}"
    with plt.style.context("dark_background"):
        figure, rows = plt.subplots(4, figsize=(10.0, 9.5), sharex=True, layout="constrained")
        _draw_time(rows, played, segment_count)
        figure.suptitle(f"CableSense: force from cable tensions\n{caption}")
        with written_whole(path, CableSenseError) as part:
            figure.savefig(part, dpi=110, format="png")
        plt.close(figure)


def _draw_time(rows: Sequence[Any], played: PushRecord, segment_count: int) -> None:
    """Force, direction, segment and place of the strongest contact, true and estimated."""
    true = [next(iter(now.true), None) for now in played.snapshots]
    estimated = [seen(now) if now.answered else None for now in played.snapshots]
    for row, name, scale, none, label in zip(
        rows,
        ("magnitude_n", "angle_deg", "segment", "contact_m"),
        (1.0, 1.0, 1, 1e3),
        (0.0, np.nan, 0, np.nan),
        ("force, N", "direction, °", "segment", "place, mm"),
        strict=True,
    ):
        for contacts, rgb, kind, width in (
            (true, TRUE_RGB, "true", 4.5),
            (estimated, ESTIMATE_RGB, "estimated", 1.6),
        ):
            values = [none if now is None else scale * _known(now, name) for now in contacts]
            row.plot(played.times_s, values, color=css(rgb), lw=width, label=kind)
        row.set_ylabel(label)
        row.grid(visible=True, alpha=0.3)
    rows[0].legend(loc="upper right", ncols=2)
    rows[1].set(ylim=(0, 360), yticks=(0, 90, 180, 270, 360))
    rows[2].set(yticks=range(segment_count + 1), ylabel="segment (0: none)")
    rows[3].set(xlabel="time, s")
