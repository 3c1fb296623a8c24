"""The table of a headless demo: every push, true against estimated."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from cablesense_ros.demo.result import PushResult, summary


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
