"""`cablesense sensors …`: tension sensors of a real arm taken into use.

`check` shows whether they can be used, from a recording or live; `calibrate` finds scale and zero
with uncertainty from known loads.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from cablesense_base.files import output_file
from cablesense_ros.cli.options import (
    ColumnsOption,
    ForceOption,
    JsonOption,
    OptionError,
    TopicsOption,
    print_json,
    print_notes,
    refuse_given,
    titled_table,
)

if TYPE_CHECKING:
    from cablesense_online.can.channel_map import SensorScales
    from cablesense_online.sensor_check import SensorExpectation, SensorReport


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
    topic: TopicsOption = None,
    gravity: Annotated[
        float | None,
        typer.Option(
            min=9.7,
            max=9.9,
            help="Local gravity, m/s²; without it 9.80665, with its variation over the Earth.",
        ),
    ] = None,
    force: ForceOption = False,
    json_output: JsonOption = False,
) -> None:
    """Find scale and zero of tension sensors from known loads, with uncertainty.

    Writes the file that can_driver takes as its parameter sensor_calibration_file. At least five
    loads of three sizes a cable, from the bare cable on, up and down again.

    Example: cablesense sensors calibrate loads.csv --map my_map.yaml --out calibration.yaml
    """
    from datetime import UTC, datetime

    import numpy as np
    from rich.console import Console

    from cablesense_online import sensor_calibration
    from cablesense_online.can import channel_map as maps
    from cablesense_recording.reading import read_recording
    from cablesense_sim.arm import open_arm

    output_file(out, force=force, inputs=(loads, channel_map, recording, recorded_with, arm))
    described, database = maps.open_channel_map(channel_map)
    as_recorded = described
    recorded = None
    if recorded_with is not None:
        earlier = maps.load_sensor_scales(recorded_with)
        as_recorded = maps.with_sensor_scales(described, database, earlier, str(recorded_with))
    if recording is not None:
        of_arm = open_arm(arm)
        recorded = read_recording(recording, of_arm, topic or ())
        as_recorded = as_recorded.arranged(of_arm.cable_names)
    else:
        refuse_given(context, ["arm", "topic"], "without --recording")
    known = sensor_calibration.read_known_loads(loads, described.cable_names)
    weighed = any(load.mass_kg is not None for of_cable in known.values() for load in of_cable)
    if not weighed:
        refuse_given(context, ["gravity"], "on loads that are all given as forces")
    gravity_m_s2 = gravity or sensor_calibration.STANDARD_GRAVITY_M_S2
    common_relative_u = 0.0
    if weighed and gravity is None:
        common_relative_u = sensor_calibration.GRAVITY_RELATIVE_U
    cables = {}
    for cable, of_cable in known.items():
        force_n = np.array([load.applied_n(gravity_m_s2) for load in of_cable])
        raw = np.array(
            [sensor_calibration.raw_reading(load, as_recorded, recorded) for load in of_cable]
        )
        cables[cable] = sensor_calibration.calibrate_sensor(
            cable, described.channels[cable], database, force_n, raw, common_relative_u
        )
    scales = maps.SensorScales(
        map=described.name,
        made=datetime.now(UTC).replace(microsecond=0),
        gravity_m_s2=gravity_m_s2 if weighed else None,
        common_relative_u=common_relative_u,
        uncalibrated=tuple(cable for cable in described.channels if cable not in cables),
        cables=cables,
    )
    maps.write_sensor_scales(out, scales)
    print_notes(() if recorded is None else recorded.notes, json_output)
    if json_output:
        print(scales.model_dump_json(indent=2))
        return
    console = Console()
    console.print(_scales_table(scales))
    if common_relative_u:
        console.print("Give --gravity: without it, masses are forces to 0.3 % only.")
    if scales.uncalibrated:
        console.print(f"Not calibrated: {', '.join(scales.uncalibrated)}", soft_wrap=True)
    console.print(
        f"{out}: give it to can_driver as -p sensor_calibration_file:={out}", soft_wrap=True
    )


def _scales_table(scales: SensorScales) -> Table:
    headings = (
        *("loads", "up to", "scale, N/unit", "zero, unit", "tension ±"),
        *("nonlinearity", "hysteresis", "repeatability"),
    )
    rows = [
        (
            cable,
            str(sensor.points),
            f"{sensor.largest_force_n:.1f}",
            f"{sensor.scale_n_per_unit:.6g} ± {sensor.scale_u95_n_per_unit:.2g}",
            f"{sensor.zero:.6g} ± {sensor.zero_u95:.2g}",
            f"{sensor.tension_u95_n:.3g}",
            _newtons(sensor.nonlinearity_n),
            _newtons(sensor.hysteresis_n),
            _newtons(sensor.repeatability_n),
        )
        for cable, sensor in scales.cables.items()
    ]
    title = "± is 95 %; all else in N"
    return titled_table(title, "cable", *headings, right=headings, rows=rows)


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
    rate: Annotated[
        float | None,
        typer.Option(min=0.1, max=10_000.0, help="Right rate, Hz.", show_default="the arm file's"),
    ] = None,
    namespace: Annotated[str, typer.Option(help="Live: of the arm's nodes.")] = "",
    columns: ColumnsOption = None,
    topic: TopicsOption = None,
    json_output: JsonOption = False,
) -> None:
    """Check rate, jitter, noise, steps and drift, and that no channel is stuck or exchanged.

    Exit code 0: usable; 1: something is wrong; 2: wrong input.

    Examples: cablesense sensors check recording.mcap --arm my_arm.yaml,
    cablesense sensors check --pull all
    """
    from dataclasses import asdict

    from rich.console import Console

    from cablesense_online.sensor_check import check_sensors, expectation
    from cablesense_recording.column_map import read_column_map
    from cablesense_recording.reading import read_recording
    from cablesense_sim.arm import open_arm

    described = open_arm(arm)
    names = described.cable_names
    expected = expectation(described.sensors, rate)
    if recording is None:
        refuse_given(context, ["columns"], "without a recording")
        from cablesense_ros.recorder import capture_tensions

        refuse_given(context, ["topic"], "without a recording")
        pulled = names if pull == "all" else tuple(pull.split(",")) if pull else ()
        unknown = [cable for cable in pulled if cable not in names]
        if unknown:
            raise OptionError(
                f"--pull: no cable {unknown[0][:40]!r}; there are {', '.join(names)}"
            )
        prompts = Console(stderr=True)
        readings, pulls = capture_tensions(names, seconds, pulled, prompts.print, namespace)
        report = check_sensors(readings, names, expected, pulls)
    else:
        refuse_given(context, ["pull", "seconds", "namespace"], "on a recording")
        meant = None if columns is None else read_column_map(columns, described).unloaded
        recorded = read_recording(recording, described, topic or (), columns=meant)
        print_notes(recorded.notes, json_output)
        report = check_sensors(recorded, names, expected)
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
