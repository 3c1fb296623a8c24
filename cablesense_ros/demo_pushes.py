"""Scripted pushes on a simulated machine, played and compared with the estimates of them.

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
from cablesense_online.felt_contact import felt_part
from cablesense_online.page.colours import ESTIMATE_RGB, TRUE_RGB, css
from cablesense_online.page.headline import Words
from cablesense_online.page.live_machine import LiveMachine
from cablesense_online.page.score import SETTLING_S, angle_error_deg
from cablesense_online.page.shown import ShownMachine
from cablesense_online.page.snapshot import Snapshot
from cablesense_ros.machine_client import MachineClient

PUSH_S = 3.0
"""How long each push is held."""
SHORTEST_SLOT_S = 4.0
"""From one push to the next, at least: a pause before it fills its slot."""
MOVE_S = 3.0
"""A move of the joints may take this long until the arm rests again."""
WEAKEST = 0.025
"""Weakest push, as a share of the strongest contact that the arm's networks learn."""
STRONGEST = 0.6
"""Strongest push, as the same share."""
MOST_ALONG = 0.2
"""Largest axial part, as a share of the normal force: below the friction of most surfaces."""
POSE_LIMIT_DEG = 8.0
"""Largest joint angle of the poses in which it is pushed."""
_RECORD_EVERY_S = 0.04
"""From one shown answer to the next."""
_LOCATED = ("magnitude_n", "contact_m", "along_n")
"""Not known of a contact of which the moment alone is."""


class ScriptError(CableSenseError):
    """A demo of a length that holds no push."""


@dataclass(frozen=True)
class ScriptedPush:
    """One push of the script; its times are since the start of the script.

    Attributes:
        contact: what pushes where, at the commanded pose.
        command: (C,) in force meanwhile.
        bent: whether that is another pose than the first, commanded at `move_s`, before the push.
    """

    start_s: float
    end_s: float
    contact: Contact
    command: Array
    bent: bool
    move_s: float


def make_script(
    shown: ShownMachine,
    touched_m: Array,
    duration_s: float,
    seed: int,
    most_along: float = MOST_ALONG,
) -> list[ScriptedPush]:
    """Pushes on one link after another, the last first: in the first pose, then in random ones.

    They act within `touched_m` (N, 2) of each link, along its axis, with up to 0.6 of the
    strongest contact to expect, in directions that are felt, and `most_along` of their force along
    the axis.

    Raises:
        ScriptError: the duration is too short for one push.
    """
    if not duration_s >= SHORTEST_SLOT_S:
        raise ScriptError(
            f"duration is {duration_s:g} s; one push takes {SHORTEST_SLOT_S:g} s at least"
        )
    rng = np.random.default_rng(seed)
    link_count = len(touched_m)
    joint_count = len(shown.felt.torque_names)
    straight_count = max(1, int(0.5 * duration_s / SHORTEST_SLOT_S))
    posed_count = int((duration_s - straight_count * SHORTEST_SLOT_S) / (SHORTEST_SLOT_S + MOVE_S))
    script = []
    now_s = 0.0
    for number in range(straight_count + posed_count):
        command = shown.felt.first_command
        end_s = now_s + SHORTEST_SLOT_S
        bent = number >= straight_count
        if bent:
            turn_rad = np.deg2rad(rng.uniform(-POSE_LIMIT_DEG, POSE_LIMIT_DEG, joint_count))
            command = shown.command_near(turn_rad)
            end_s += MOVE_S
        magnitude_n = shown.strongest_n * WEAKEST * (STRONGEST / WEAKEST) ** rng.random()
        segment = link_count - number % link_count
        anywhere = Contact(segment, angle_deg=float(rng.uniform(0.0, 360.0)), magnitude_n=1.0)
        felt = felt_part(anywhere, shown.felt.felt_across[segment - 1])
        contact = Contact(
            segment=segment,
            angle_deg=felt.angle_deg,
            magnitude_n=float(f"{magnitude_n:.3g}"),
            contact_m=float(rng.uniform(*touched_m[segment - 1])),
            along_n=float(magnitude_n * rng.uniform(-most_along, most_along)),
        )
        script.append(ScriptedPush(end_s - PUSH_S, end_s, contact, command, bent, move_s=now_s))
        now_s = end_s
    return script


class PushRecord(NamedTuple):
    """Snapshots at K instants, and their times (K,) since the start of the script, s."""

    times_s: Array
    snapshots: Sequence[Snapshot]


def play_script(
    client: MachineClient,
    live: LiveMachine,
    script: Sequence[ScriptedPush],
    check: Callable[[], object],
    progress: Callable[[float], object],
) -> PushRecord:
    """Play the script in real time.

    At every step `check` is called, which raises to end the play, and `progress` with the share of
    the script that is done.
    """
    due: deque[tuple[float, Callable[[], None]]] = deque()
    for push in script:
        if push.bent:
            due.append((push.move_s, partial(client.command, push.command)))
        due.append((push.start_s, partial(client.push, push.contact)))
        due.append((push.end_s, partial(client.push, NO_CONTACT)))
    times_s = []
    snapshots = []
    start_s = time.monotonic()
    while (now_s := time.monotonic() - start_s) < script[-1].end_s:
        check()
        while due and due[0][0] <= now_s:
            due.popleft()[1]()
        progress(now_s / script[-1].end_s)
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
        sample_count: steady instants looked at; 0 when no estimates came.
        force_ci95_n: ends of the stated interval; None without one.
        place_ci95_m: ends of the stated interval, each with its segment; None without one.
    """

    push: ScriptedPush
    estimate: Contact | None
    sample_count: int
    force_ci95_n: tuple[float, float] | None = None
    place_ci95_m: tuple[tuple[int, float], tuple[int, float]] | None = None

    @property
    def force_covered(self) -> bool | None:
        """Whether the force is within its stated interval; None without one."""
        if self.force_ci95_n is None:
            return None
        low_n, high_n = self.force_ci95_n
        return low_n <= self.push.contact.magnitude_n <= high_n

    @property
    def place_covered(self) -> bool | None:
        """Whether the place is within its stated interval; None without one."""
        if self.place_ci95_m is None:
            return None
        true = self.push.contact
        low, high = self.place_ci95_m
        return low <= (true.segment, true.contact_m) <= high

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
        estimate = self.estimate
        true = self.push.contact
        if estimate is None or not self.segment_right:
            return {}
        errors = {"direction_deg": angle_error_deg(estimate.angle_deg, true.angle_deg)}
        if estimate.moment_n_m is not None:
            return errors | {"moment_n_m": estimate.moment_n_m - true.contact_m * true.magnitude_n}
        return errors | {
            "place_mm": 1e3 * (estimate.contact_m - true.contact_m),
            "magnitude_n": estimate.magnitude_n - true.magnitude_n,
        }


def seen(now: Snapshot) -> Contact | None:
    """The estimate of the strongest contact."""
    return now.known_by_moment or next(iter(now.estimated), None)


def push_results(script: Sequence[ScriptedPush], played: PushRecord) -> list[PushResult]:
    """The result of every push."""
    results = []
    for push in script:
        steady = (played.times_s >= push.start_s + SETTLING_S) & (
            played.times_s < push.end_s - 0.1
        )
        steady_snapshots = [played.snapshots[i] for i in np.flatnonzero(steady).tolist()]
        answered = [now for now in steady_snapshots if now.answered]
        contacts = [seen(now) for now in answered]
        ends = _median_ends(answered)
        results.append(PushResult(push, _median(contacts), len(contacts), *ends))
    return results


def _median_ends(answered: Sequence[Snapshot]) -> tuple[Any, Any]:
    """The median ends of the stated intervals of force and place; None where none was stated."""
    forces_n = [now.bounds[:2] for now in answered if now.bounds is not None and seen(now)]
    force_n = tuple(np.median(forces_n, axis=0).tolist()) if forces_n else None
    regions = [now.region for now in answered if now.region]
    if not regions:
        return force_n, None
    lows = sorted((region[0].segment, region[0].low_m) for region in regions)
    highs = sorted((region[-1].segment, region[-1].high_m) for region in regions)
    middle = len(regions) // 2
    return force_n, (lows[middle], highs[middle])


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
    """Mean errors over the pushes found on their segment; None where there are none.

    Beside them, in how many of the stated intervals the truth lies.
    """

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
        "place_intervals": sum(result.place_covered is not None for result in results),
        "place_covered": sum(bool(result.place_covered) for result in results),
        "force_intervals": sum(result.force_covered is not None for result in results),
        "force_covered": sum(bool(result.force_covered) for result in results),
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
                "force_ci95_n": result.force_ci95_n,
                "place_ci95_m": result.place_ci95_m,
            }
            for result in results
        ],
    }


def _median_errors(results: Sequence[PushResult]) -> dict[str, str]:
    """The medians that people are shown, by quantity: one wide interval does not hide the rest."""

    def median(name: str) -> float | None:
        known = [abs(result.errors[name]) for result in results if name in result.errors]
        return float(np.median(known)) if known else None

    return {
        "place": _text("{:.1f} mm", median("place_mm")),
        "direction": _text("{:.2f}°", median("direction_deg")),
        "force": _text("{:.2f} N", median("magnitude_n")),
    }


def coverage_line(results: Sequence[PushResult]) -> str:
    """In how many of the stated intervals the truth lies."""
    counts = summary(results)
    places = f"{counts['place_covered']} of {counts['place_intervals']} places"
    forces = f"{counts['force_covered']} of {counts['force_intervals']} forces"
    return f"Within their stated 95 % intervals: {places}, {forces}"


def results_table(results: Sequence[PushResult], words: Words) -> Table:
    """One row for each push, median errors in the footer; red is outside its stated interval."""
    first = "the straight arm" if words.machine == "arm" else "the first pose"
    title = f"True against estimated: {first}, then bent"
    table = Table(title=title, show_footer=True, title_justify="left")
    right = f"{sum(result.segment_right for result in results)} of {len(results)}"
    head = f"true {words.link}, place,\ndirection, force"
    table.add_column(head, f"{words.link}s right, median errors", justify="right", no_wrap=True)
    table.add_column(f"estimated\n{words.link}", right, justify="right")
    for name, mean in _median_errors(results).items():
        table.add_column(f"{name}\nerror", mean, justify="right")
    straight = sum(not result.push.bent for result in results)
    for number, result in enumerate(results, start=1):
        true = result.push.contact
        errors = result.errors
        label = words.links[true.segment - 1]
        table.add_row(
            f"{label} {1e3 * true.contact_m:4.0f} mm {true.angle_deg:6.1f}° "
            f"{true.magnitude_n:6.1f} N",
            f"[{'green' if result.segment_right else 'red'}]{_found(result, words)}[/]",
            _judged(_text("{:+.1f} mm", errors.get("place_mm")), result.place_covered),
            _text("{:.2f}°", errors.get("direction_deg")),
            _text("{:+.2f} N·m", errors.get("moment_n_m"))
            if result.moment_alone
            else _judged(_text("{:+.2f} N", errors.get("magnitude_n")), result.force_covered),
            end_section=number == straight,
        )
    return table


def _own_region_mm(now: Snapshot) -> tuple[float, float]:
    """What the interval of the place covers of the segment of the contact."""
    contact = seen(now) if now.state.known else None
    for part in now.region:
        if contact is not None and part.segment == contact.segment:
            return 1e3 * part.low_m, 1e3 * part.high_m
    return np.nan, np.nan


def _found(result: PushResult, words: Words) -> str:
    if result.estimate is None:
        return "no contact" if result.sample_count else "no estimate"
    moment = ", moment" if result.moment_alone else ""
    return f"{words.links[result.estimate.segment - 1]}{moment}"


def _judged(text: str, covered: bool | None) -> str:
    return f"[red]{text}[/]" if covered is False else text


def _known(contact: Contact, name: str) -> float:
    """A number of a contact; of a moment neither force nor place is known."""
    unknown = contact.moment_n_m is not None and name in _LOCATED
    return np.nan if unknown else float(getattr(contact, name))


def _text(form: str, value: float | None) -> str:
    return "–" if value is None else form.format(value)


def draw_pushes(
    path: Path, played: PushRecord, results: Sequence[PushResult], words: Words
) -> None:
    """Draw true and estimated contacts over time, as PNG."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    right = sum(result.segment_right for result in results)
    caption = f"{right} of {len(results)} pushes on the right {words.link}"
    if right:
        medians = (f"{name} {median}" for name, median in _median_errors(results).items())
        caption += f"; median errors: {', '.join(medians)}"
    caption += f"\n{coverage_line(results)}"
    with plt.style.context("dark_background"):
        figure, rows = plt.subplots(4, figsize=(10.0, 9.5), sharex=True, layout="constrained")
        _draw_time(rows, played, words)
        figure.suptitle(f"CableSense: force from cable tensions\n{caption}")
        with written_whole(path, CableSenseError) as part:
            figure.savefig(part, dpi=110, format="png")
        plt.close(figure)


def _draw_time(rows: Sequence[Any], played: PushRecord, words: Words) -> None:
    """Force, direction, segment and place of the strongest contact, true and estimated.

    Bands are the stated intervals; what the estimator does not confirm is left out.
    """
    true = [next(iter(now.true), None) for now in played.snapshots]
    estimated = [seen(now) for now in played.snapshots]
    confirmed = np.array([now.state.known for now in played.snapshots])
    bounds_n = [
        now.bounds[:2] if now.state.known and now.bounds else (np.nan, np.nan)
        for now in played.snapshots
    ]
    places_mm = [_own_region_mm(now) for now in played.snapshots]
    for row, ends in ((rows[0], bounds_n), (rows[3], places_mm)):
        low, high = np.array(ends).T
        row.fill_between(played.times_s, low, high, color=css(ESTIMATE_RGB), alpha=0.35, lw=0)
    for row, name, scale, absent, label in zip(
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
            values = np.array(
                [absent if now is None else scale * _known(now, name) for now in contacts]
            )
            if contacts is estimated:
                values = np.where(confirmed, values, np.nan)
            row.plot(played.times_s, values, color=css(rgb), lw=width, label=kind)
        row.set_ylabel(label)
        row.grid(visible=True, alpha=0.3)
    rows[0].legend(loc="upper right", ncols=2)
    rows[1].set(ylim=(0, 360), yticks=(0, 90, 180, 270, 360))
    labels = ("none", *words.links)
    rows[2].set_yticks(range(len(labels)), labels, fontsize=10 if len(labels) < 6 else 6)
    rows[2].set(ylabel=words.link)
    rows[3].set(xlabel="time, s")
