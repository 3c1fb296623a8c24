"""`cablesense sensors …`: tension sensors of a real arm taken into use.

`check` shows whether they can be used, from a recording or live; `calibrate` finds scale and zero
with uncertainty from known loads.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from cablesense_base.files import output_file
from cablesense_ros.cli.options import (
    ForceOption,
    JsonOption,
    print_json,
    refuse_given,
    titled_table,
)

if TYPE_CHECKING:
    from cablesense_online.commissioning.sensor_calibration import SensorCalibration
    from cablesense_online.commissioning.sensor_check import SensorExpectation, SensorReport
    from cablesense_online.commissioning.tables import KnownLoad


def calibrate(
    context: typer.Context,
    loads: Annotated[
        Path,
        typer.Argument(
            help="CSV: cable; mass_kg or force_n; raw, or start_s and end_s of the recording."
        ),
    ],
    out: Annotated[Path, typer.Option(help="The calibration file to write, .yaml.")],
    channel_map: Annotated[
        str, typer.Option("--map", help="Channel map of the driver: a bundled name, or a path.")
    ] = "twelve_channel_amplifier",
    recording: Annotated[
        Path | None,
        typer.Option(help="Recording that the windows of the loads refer to: .csv or .mcap."),
    ] = None,
    recorded_with: Annotated[
        Path | None,
        typer.Option(help="The calibration that the driver used during the recording, if any."),
    ] = None,
    arm: Annotated[
        str, typer.Option(help="Arm of the recording: a path, or the name of a bundled one.")
    ] = "cdsm",
    gravity: Annotated[
        float | None,
        typer.Option(
            min=9.7,
            max=9.9,
            help="Local gravity, m/s²; without it 9.80665, with its variation over the Earth.",
        ),
    ] = None,
    reference_uncertainty: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=10.0,
            help="Standard uncertainty that all loads share (gauge, set of weights), percent.",
        ),
    ] = 0.0,
    force: ForceOption = False,
    json_output: JsonOption = False,
) -> None:
    """Find scale and zero of tension sensors from known loads, with uncertainty.

    Writes the file that can_driver takes as its parameter calibration. At least five loads of
    three sizes a cable, from the bare cable on, up and down again.

    Example: cablesense sensors calibrate loads.csv --map my_map.yaml --out calibration.yaml
    """
    from datetime import UTC, datetime

    from rich.console import Console

    from cablesense_gap.recordings.checks import read_recording
    from cablesense_online.can.calibration import calibrated, load_calibration, write_calibration
    from cablesense_online.can.channel_map import open_channel_map
    from cablesense_online.commissioning.sensor_calibration import (
        calibrate_sensor,
        calibration_point,
        calibration_record,
    )
    from cablesense_online.commissioning.tables import (
        GRAVITY_RELATIVE_U,
        STANDARD_GRAVITY_M_S2,
        read_known_loads,
    )
    from cablesense_sim.arm import open_arm

    output_file(out, force=force, inputs=(loads, channel_map, recording, recorded_with, arm))
    described, database = open_channel_map(channel_map)
    as_recorded, recorded = described, None
    if recorded_with is not None:
        earlier = load_calibration(recorded_with)
        as_recorded = calibrated(described, database, earlier, str(recorded_with))
    if recording is not None:
        of_arm = open_arm(arm)
        recorded = read_recording(recording, of_arm)
        as_recorded = as_recorded.arranged(of_arm.cable_names)
    else:
        refuse_given(context, ["arm"], "without --recording")
    gravity_m_s2 = STANDARD_GRAVITY_M_S2 if gravity is None else gravity
    known = read_known_loads(loads, described.cable_names, gravity_m_s2)
    weighed = any(load.by_mass for of_cable in known.values() for load in of_cable)
    if not weighed:
        refuse_given(context, ["gravity"], "on loads that are all given as forces")
    gravity_u = GRAVITY_RELATIVE_U if weighed and gravity is None else 0.0
    common_relative_u = float((gravity_u**2 + (reference_uncertainty / 100.0) ** 2) ** 0.5)
    points = {
        cable: [calibration_point(load, as_recorded, recorded) for load in of_cable]
        for cable, of_cable in known.items()
    }
    found = {
        cable: calibrate_sensor(cable, of_cable, common_relative_u)
        for cable, of_cable in points.items()
    }
    made = datetime.now(UTC).replace(microsecond=0)
    used_m_s2 = gravity_m_s2 if weighed else None
    calibration = calibration_record(
        found, described, database, made, used_m_s2, common_relative_u
    )
    write_calibration(out, calibration)
    if json_output:
        print(calibration.model_dump_json(indent=2))
        return
    console = Console()
    console.print(_table(found, known))
    if gravity_u:
        console.print("Give --gravity: without it, masses are forces to 0.3 % only.")
    if calibration.uncalibrated:
        console.print(f"Not calibrated: {', '.join(calibration.uncalibrated)}", soft_wrap=True)
    console.print(f"{out}: give it to can_driver as -p calibration:={out}", soft_wrap=True)


def _table(
    found: Mapping[str, SensorCalibration], known: Mapping[str, Sequence[KnownLoad]]
) -> Table:
    headings = (
        *("loads", "up to", "scale, N/unit", "zero, unit", "tension ±"),
        *("nonlinearity", "hysteresis", "repeatability", "furthest off, line"),
    )
    table = titled_table("± is 95 %; all else in N", "cable", *headings, right=headings)
    for cable, sensor in found.items():
        line = known[cable][sensor.largest_residual_at].where.rpartition(" ")[2]
        table.add_row(
            cable,
            str(sensor.points),
            f"{sensor.largest_force_n:.1f}",
            f"{sensor.scale_n_per_unit:.6g} ± {sensor.scale_u95_n_per_unit:.2g}",
            f"{sensor.zero:.6g} ± {sensor.zero_u95:.2g}",
            f"{sensor.tension_u95_n:.3g}",
            _newtons(sensor.nonlinearity_n),
            _newtons(sensor.hysteresis_n),
            _newtons(sensor.repeatability_n),
            f"{sensor.largest_residual_n:+.3f}, {line}",
        )
    return table


def _newtons(value: float | None, form: str = ".3f", missing: str = "not shown") -> str:
    return missing if value is None else f"{value:{form}}"


def check(
    context: typer.Context,
    recording: Annotated[
        Path | None,
        typer.Argument(
            help="A .csv file, a .mcap file or a rosbag2 folder.",
            show_default="live, from the topic cable_tensions",
        ),
    ] = None,
    arm: Annotated[
        str,
        typer.Option(help="Arm, whose file gives the expected values: a path, or a bundled name."),
    ] = "cdsm",
    seconds: Annotated[
        float,
        typer.Option(min=2.0, max=3600.0, help="Live: time for which the arm is left alone, s."),
    ] = 10.0,
    pull: Annotated[
        str | None,
        typer.Option(
            help="Live: cables that you pull by hand when asked, joined by commas, or all; shows "
            "exchanged plugs."
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
            show_default="four standard deviations of a reading",
        ),
    ] = None,
    namespace: Annotated[str, typer.Option(help="Live: of the arm's nodes.")] = "",
    json_output: JsonOption = False,
) -> None:
    """Check rate, jitter, noise, steps and drift, and that no channel is stuck or exchanged.

    Exit code 0: usable; 1: something is wrong; 2: wrong input.

    Examples: cablesense sensors check recording.mcap --arm my_arm.yaml,
    cablesense sensors check --pull all
    """
    from dataclasses import asdict, replace

    from rich.console import Console

    from cablesense_gap.recordings.checks import read_recording
    from cablesense_online.commissioning.sensor_check import (
        check_sensors,
        exercised_channel_findings,
        expectation,
    )
    from cablesense_online.commissioning.sensor_statistics import series_of
    from cablesense_online.commissioning.tables import CommissioningError, read_pulls
    from cablesense_sim.arm import open_arm

    described = open_arm(arm)
    names = described.cable_names
    expected = expectation(described.sensors, rate, drift_limit)
    if recording is None:
        from cablesense_ros.tension_capture import capture_tensions

        if pulls is not None:
            raise CommissioningError("--pulls is for a recording; live it is --pull all")
        pulled = names if pull == "all" else tuple(pull.split(",")) if pull else ()
        unknown = [cable for cable in pulled if cable not in names]
        if unknown:
            raise CommissioningError(
                f"--pull: no cable {unknown[0][:40]!r}; there are {', '.join(names)}"
            )
        prompts = Console(stderr=True)
        series, made = capture_tensions(names, seconds, pulled, prompts.print, namespace)
        report = check_sensors(series, expected, made)
    else:
        if pull is not None:
            raise CommissioningError("--pull is for a live arm; of a recording it is --pulls FILE")
        refuse_given(context, ["seconds", "namespace"], "on a recording")
        recorded = read_recording(recording, described)
        made = [] if pulls is None else read_pulls(pulls, names)
        report = check_sensors(series_of(recorded, names), expected, made)
        found = exercised_channel_findings(recorded, described)
        report = replace(report, findings=(*found, *report.findings))
    if json_output:
        print_json({"usable": report.usable, "expected": asdict(expected), **asdict(report)})
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
        raise typer.Exit(1)


sensors = typer.Typer(
    name="sensors",
    help="Takes the tension sensors of a real arm into use.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)
for verb in (check, calibrate):
    sensors.command()(verb)


def check_table(report: SensorReport, expected: SensorExpectation) -> Table:
    """One row a sensor; wrong values are red."""
    timing = report.timing
    title = (
        f"{timing.samples:,} samples at {timing.rate_hz:.1f} Hz (right: {expected.rate_hz:g} "
        f"± 5 %), jitter {1e3 * timing.jitter_s:.2f} ms (≤ {1e3 * expected.jitter_s:.2f}), "
        f"{timing.lost} lost"
    )
    step = f"≤ {expected.step_n:.3f}" if expected.step_n else "any"
    pulled = {result.cable: f"{result.moved}, {result.verdict}" for result in report.pulls}
    headings = (
        *("at rest, N", f"noise, N\n≤ {expected.noise_n:.3f}", f"step, N\n{step}"),
        f"drift, N\n≤ {expected.drift_n:.2f}",
        *(["pulled, moved most\nitself"] if pulled else []),
    )
    table = titled_table(title, "cable", *headings, right=headings)
    wrong = {(finding.where, finding.kind) for finding in report.findings if finding.wrong}
    for channel in report.channels:
        cells = {
            "stuck": channel.cable,
            "range": f"{channel.mean_n:.2f}",
            "noise": _newtons(channel.noise_n, ".3f", "unknown"),
            "step": _newtons(channel.step_n, ".3f", "none seen"),
            "drift": _newtons(channel.drift_n, "+.2f", "unknown"),
        } | ({"swapped": pulled.get(channel.cable, "")} if pulled else {})
        marked = (
            f"[red]{text}[/red]" if (channel.cable, kind) in wrong else text
            for kind, text in cells.items()
        )
        table.add_row(*marked)
    return table
