"""`cablesense sensors calibrate`: known weights to scale and zero, with uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from cablesense_ros.commissioning.known_load import KnownLoad
    from cablesense_ros.commissioning.sensor_calibration import SensorCalibration


def calibrate(
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
        Path | None, typer.Option(help="Where the windows of the loads lie: .csv or .mcap.")
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
            help="Local gravity, m/s²; without it 9.80665, and its spread over the Earth counts.",
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
    json_output: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Find scale and zero of tension sensors from known loads, and how sure they are.

    Writes the file that can_driver takes as its parameter calibration. At least five loads of
    three sizes a cable, from the bare cable on, up and down again.

    Example: cablesense sensors calibrate loads.csv --map my_map.yaml --out calibration.yaml
    """
    from datetime import UTC, datetime

    from rich.console import Console

    from cablesense_gap.recordings.reading import read_recording
    from cablesense_ros.can.calibration import calibrated
    from cablesense_ros.can.calibration_file import load_calibration, write_calibration
    from cablesense_ros.can.signal_database import open_channel_map
    from cablesense_ros.commissioning.calibration_points import calibration_points
    from cablesense_ros.commissioning.calibration_record import calibration_record
    from cablesense_ros.commissioning.commissioning_error import CommissioningError
    from cablesense_ros.commissioning.known_load import (
        GRAVITY_RELATIVE_U,
        STANDARD_GRAVITY_M_S2,
        read_known_loads,
    )
    from cablesense_ros.commissioning.sensor_calibration import calibrate_sensor
    from cablesense_sim.arm_files import open_arm

    if out.exists():
        raise CommissioningError(f"{out}: exists already; give another --out, or move it away")
    described, database = open_channel_map(channel_map)
    as_recorded, recorded = described, None
    if recorded_with is not None:
        earlier = load_calibration(recorded_with)
        as_recorded = calibrated(described, database, earlier, str(recorded_with))
    if recording is not None:
        of_arm = open_arm(arm)
        recorded = read_recording(recording, of_arm)
        as_recorded = as_recorded.arranged(of_arm.cable_names)
    gravity_m_s2 = STANDARD_GRAVITY_M_S2 if gravity is None else gravity
    known = read_known_loads(loads, described.cable_names, gravity_m_s2)
    weighed = any(load.by_mass for of_cable in known.values() for load in of_cable)
    gravity_u = GRAVITY_RELATIVE_U if weighed and gravity is None else 0.0
    common_relative_u = float((gravity_u**2 + (reference_uncertainty / 100.0) ** 2) ** 0.5)
    found = {
        cable: calibrate_sensor(cable, points, common_relative_u)
        for cable, points in calibration_points(known, as_recorded, recorded).items()
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
    from rich.table import Table

    table = Table(title="± is 95 %; all else in N", title_justify="left", header_style="bold")
    table.add_column("cable")
    for heading in ("loads", "up to", "scale, N/unit", "zero, unit", "tension ±"):
        table.add_column(heading, justify="right")
    for heading in ("nonlinearity", "hysteresis", "repeatability", "furthest off, line"):
        table.add_column(heading, justify="right")
    for cable, sensor in found.items():
        line = known[cable][sensor.largest_residual_at].where.rpartition(" ")[2]
        table.add_row(
            cable,
            str(sensor.points),
            f"{sensor.largest_force_n:.1f}",
            f"{sensor.scale_n_per_unit:.6g} ± {sensor.scale_u95_n_per_unit:.2g}",
            f"{sensor.zero:.6g} ± {sensor.zero_u95:.2g}",
            f"{sensor.tension_u95_n:.3g}",
            _newtons(sensor.figures.nonlinearity_n),
            _newtons(sensor.figures.hysteresis_n),
            _newtons(sensor.figures.repeatability_n),
            f"{sensor.largest_residual_n:+.3f}, {line}",
        )
    return table


def _newtons(value: float | None) -> str:
    return "not shown" if value is None else f"{value:.3f}"
