"""The figures of a sensor check as a table, with what would be right above each column."""

from __future__ import annotations

from rich.table import Table

from cablesense_ros.commissioning.sensor_check import SensorReport
from cablesense_ros.commissioning.sensor_expectation import SensorExpectation


def check_table(report: SensorReport, expected: SensorExpectation) -> Table:
    """One row a sensor; what is wrong is red."""
    timing = report.timing
    title = (
        f"{timing.samples:,} samples at {timing.rate_hz:.1f} Hz (right: {expected.rate_hz:g} "
        f"± 5 %), jitter {1e3 * timing.jitter_s:.2f} ms (≤ {1e3 * expected.jitter_s:.2f}), "
        f"{timing.lost} lost"
    )
    table = Table(title=title, title_justify="left", header_style="bold")
    table.add_column("cable")
    table.add_column("at rest, N", justify="right")
    table.add_column(f"noise, N\n≤ {expected.noise_n:.3f}", justify="right")
    step = f"≤ {expected.step_n:.3f}" if expected.step_n else "any"
    table.add_column(f"step, N\n{step}", justify="right")
    table.add_column(f"drift, N\n≤ {expected.drift_n:.2f}", justify="right")
    pulled = {result.cable: result for result in report.pulls}
    if pulled:
        table.add_column("pulled, moved most\nitself", justify="right")
    wrong = {(finding.where, finding.kind) for finding in report.findings if finding.wrong}
    for channel in report.channels:

        def cell(text: str, kind: str, cable: str = channel.cable) -> str:
            return f"[red]{text}[/red]" if (cable, kind) in wrong else text

        cells = [
            cell(channel.cable, "stuck"),
            cell(f"{channel.mean_n:.2f}", "range"),
            cell(_newtons(channel.noise_n, ".3f", "not told"), "noise"),
            cell(_newtons(channel.step_n, ".3f", "none seen"), "step"),
            cell(_newtons(channel.drift_n, "+.2f", "not told"), "drift"),
        ]
        if pulled:
            result = pulled.get(channel.cable)
            text = "" if result is None else f"{result.moved}, {result.verdict}"
            cells.append(cell(text, "swapped"))
        table.add_row(*cells)
    return table


def _newtons(value: float | None, form: str, missing: str) -> str:
    return missing if value is None else f"{value:{form}}"
