"""The table of a headless demo: every push, true against estimated."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from cablesense_ros.demo.result import PushResult, summary


def results_table(results: Sequence[PushResult]) -> Table:
    """One row for each push, mean errors in the footer."""
    found = summary(results)
    direction, force = found["direction_mae_deg"], found["magnitude_mae_n"]
    table = Table(
        title="True against estimated", show_footer=True, title_justify="left", header_style="bold"
    )
    right = f"{found['segment_right']} of {found['pushes']} right"
    table.add_column("pose", footer="mean")
    table.add_column("segment", justify="right")
    table.add_column("estimated", justify="right", footer=right)
    table.add_column("direction", justify="right")
    table.add_column("estimated", justify="right")
    table.add_column("error", justify="right", footer=_figure(direction, "°"))
    table.add_column("force", justify="right")
    table.add_column("estimated", justify="right")
    table.add_column("error", justify="right", footer=_figure(force, " N"))
    for result in results:
        table.add_row(*_row(result))
    return table


def _row(result: PushResult) -> tuple[str, ...]:
    push, estimate = result.push, result.estimate
    pose = "bent" if push.command_rad.any() else "straight"
    true = (str(push.segment), f"{push.angle_deg:.1f}°", f"{push.magnitude_n:.1f} N")
    if estimate is None:
        word = "none" if result.sample_count else "no estimate"
        return pose, true[0], f"[red]{word}[/]", true[1], "", "", true[2], "", ""
    mark = "green" if result.segment_right else "red"
    return (
        pose,
        true[0],
        f"[{mark}]{estimate.segment}[/]",
        true[1],
        f"{estimate.angle_deg:.1f}°",
        _figure(result.angle_error_deg, "°"),
        true[2],
        f"{estimate.magnitude_n:.1f} N",
        _figure(result.magnitude_error_n, " N", signed=True),
    )


def _figure(value: float | None, unit: str, signed: bool = False) -> str:
    if value is None:
        return "–"
    return f"{value:+.2f}{unit}" if signed else f"{value:.2f}{unit}"
