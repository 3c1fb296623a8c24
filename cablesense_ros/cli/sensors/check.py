"""`cablesense sensors check`: whether tension sensors can be used, from a recording or live."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

EXIT_UNUSABLE = 1


def check(
    recording: Annotated[
        Path | None,
        typer.Argument(
            help="A .csv file, a .mcap file or a rosbag2 folder.",
            show_default="live, from the topic cable_tensions",
        ),
    ] = None,
    arm: Annotated[
        str, typer.Option(help="Arm, which says what is right: a path, or a bundled one's name.")
    ] = "cdsm",
    seconds: Annotated[
        float, typer.Option(min=2.0, max=3600.0, help="Live: how long the arm is left alone.")
    ] = 10.0,
    pull: Annotated[
        str | None,
        typer.Option(
            help="Live: cables that you pull by hand when told, joined by commas, or all; shows "
            "exchanged plugs.",
        ),
    ] = None,
    pulls: Annotated[
        Path | None,
        typer.Option(help="Of a recording: CSV with cable, start_s, end_s of pulls by hand."),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(min=0.1, max=10_000.0, help="Right rate, Hz.", show_default="the arm file's"),
    ] = None,
    drift_limit: Annotated[
        float | None,
        typer.Option(
            min=0.001,
            max=1000.0,
            help="Most drift at rest that is right, N.",
            show_default="four times what a reading varies by",
        ),
    ] = None,
    json_output: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Check rate, jitter, noise, steps and drift, and that no channel is stuck or exchanged.

    Exit code 0: usable; 1: something is wrong; 2: wrong input.

    Examples: cablesense sensors check recording.mcap --arm my_arm.yaml,
    cablesense sensors check --pull all
    """
    import json
    from dataclasses import asdict, replace

    from rich.console import Console

    from cablesense_gap.recordings.reading import read_recording
    from cablesense_ros.cli.sensors.check_table import check_table
    from cablesense_ros.commissioning.commissioning_error import CommissioningError
    from cablesense_ros.commissioning.exercised_channels import exercised_channel_findings
    from cablesense_ros.commissioning.pull_check import read_pulls
    from cablesense_ros.commissioning.sensor_check import check_sensors
    from cablesense_ros.commissioning.sensor_expectation import expectation
    from cablesense_ros.commissioning.tension_series import series_of
    from cablesense_sim.arm_files import open_arm

    described = open_arm(arm)
    names = described.cable_names
    expected = expectation(described.sensors, rate, drift_limit)
    if recording is None:
        from cablesense_ros.commissioning.live_tensions import listen_to_tensions

        if pulls is not None:
            raise CommissioningError("--pulls is for a recording; live it is --pull all")
        pulled = names if pull == "all" else tuple(pull.split(",")) if pull else ()
        unknown = [cable for cable in pulled if cable not in names]
        if unknown:
            raise CommissioningError(
                f"--pull: no cable {unknown[0][:40]!r}; there are {', '.join(names)}"
            )
        said = Console(stderr=True)
        series, made = listen_to_tensions(names, seconds, pulled, said.print)
        report = check_sensors(series, expected, made)
    else:
        if pull is not None:
            raise CommissioningError("--pull is for a live arm; of a recording it is --pulls FILE")
        recorded = read_recording(recording, described)
        made = [] if pulls is None else read_pulls(pulls, names)
        report = check_sensors(series_of(recorded, names), expected, made)
        found = exercised_channel_findings(recorded, described)
        report = replace(report, findings=(*found, *report.findings))
    if json_output:
        content = {"usable": report.usable, "expected": asdict(expected), **asdict(report)}
        print(json.dumps(content, indent=2))
    else:
        console = Console()
        console.print(check_table(report, expected))
        for finding in report.findings:
            where = "" if finding.where == "all" else f"{finding.where} "
            kind = "wrong" if finding.wrong else "note"
            console.print(f"{kind}: {where}{finding.text}", soft_wrap=True, markup=False)
        if report.usable:
            console.print("Nothing wrong was found.")
    if not report.usable:
        raise typer.Exit(EXIT_UNUSABLE)
