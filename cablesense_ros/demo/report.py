"""The report of a headless demo: its figures as a table and as plain values, and a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from cablesense_base import CableSenseError
from cablesense_base.files import written_whole
from cablesense_msgs_py.messages import Contact
from cablesense_online.page.drawing import ESTIMATE_RGB, TRUE_RGB, css
from cablesense_online.page.snapshot import KnownMoment
from cablesense_ros.demo.pushes import PushRecord, PushResult, Seen, seen, summary


def metrics(results: Sequence[PushResult]) -> dict[str, Any]:
    """Everything that the table shows, as plain values."""

    def plain(contact: Contact | Seen) -> dict[str, float]:
        """Force and place, or the moment where that is known alone; base axes aside."""
        numbers = contact._asdict() if isinstance(contact, tuple) else vars(contact)
        return {name: n for name, n in numbers.items() if isinstance(n, int | float)}

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


def results_table(results: Sequence[PushResult]) -> Table:
    """One row for each push, mean errors in the footer."""
    mean = summary(results)
    title = "True against estimated: the straight arm, then bent"
    table = Table(title=title, show_footer=True, title_justify="left")
    right = f"{mean['segment_right']} of {mean['pushes']}"
    head = "true segment, place,\ndirection, force"
    table.add_column(head, "segments right, mean errors", justify="right", no_wrap=True)
    table.add_column("estimated\nsegment", right, justify="right")
    for name, value, form in (
        ("place", mean["place_mae_mm"], "{:.1f} mm"),
        ("direction", mean["direction_mae_deg"], "{:.2f}°"),
        ("force", mean["magnitude_mae_n"], "{:.2f} N"),
    ):
        table.add_column(f"{name}\nerror", _text(form, value), justify="right")
    straight = sum(not result.push.command_rad.any() for result in results)
    for number, result in enumerate(results, start=1):
        table.add_row(
            _contact(result.push.contact),
            f"[{'green' if result.segment_right else 'red'}]{_found(result)}[/]",
            _text("{:+.1f} mm", result.place_error_mm),
            _text("{:.2f}°", result.angle_error_deg),
            _text("{:+.2f} N·m", result.moment_error_n_m)
            if isinstance(result.estimate, KnownMoment)
            else _text("{:+.2f} N", result.magnitude_error_n),
            end_section=number == straight,
        )
    return table


def _contact(contact: Contact) -> str:
    place_mm = 1e3 * contact.contact_m
    return (
        f"{contact.segment} {place_mm:4.0f} mm {contact.angle_deg:6.1f}° "
        f"{contact.magnitude_n:6.1f} N"
    )


def _found(result: PushResult) -> str:
    if result.estimate is None:
        return "no contact" if result.sample_count else "no estimate"
    moment = ", moment" if isinstance(result.estimate, KnownMoment) else ""
    return f"{result.estimate.segment}{moment}"


def _text(form: str, value: float | None) -> str:
    return "–" if value is None else form.format(value)


def draw_pushes(
    path: Path, played: PushRecord, results: Sequence[PushResult], segment_count: int
) -> None:
    """Draw true and estimated contacts over time, as PNG."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    found = summary(results)
    caption = f"{found['segment_right']} of {found['pushes']} pushes on the right segment"
    if found["segment_right"]:
        errors = {
            "place": _text("{:.1f} mm", found["place_mae_mm"]),
            "direction": _text("{:.2f}°", found["direction_mae_deg"]),
            "force": _text("{:.2f} N", found["magnitude_mae_n"]),
        }
        caption += "; mean errors: " + ", ".join(f"{name} {e}" for name, e in errors.items())
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
            # of a moment neither force nor place is known
            values = [
                none if now is None else scale * getattr(now, name, np.nan) for now in contacts
            ]
            row.plot(played.times_s, values, color=css(rgb), lw=width, label=kind)
        row.set_ylabel(label)
        row.grid(visible=True, alpha=0.3)
    rows[0].legend(loc="upper right", ncols=2)
    rows[1].set(ylim=(0, 360), yticks=(0, 90, 180, 270, 360))
    rows[2].set(yticks=range(segment_count + 1), ylabel="segment (0: none)")
    rows[3].set(xlabel="time, s")
