"""`cablesense gap protocol` and `record`: what to record for a diagnosis, and the recording."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from cablesense_base.files import output_file
from cablesense_ros.cli.options import (
    DurationOption,
    ForceOption,
    ModelOption,
    NominalArmOption,
    RecordingFile,
    refuse_given,
)
from cablesense_ros.cli.results import titled_table

_KEEP_ONE = (
    "Record one after commissioning, and keep it: cablesense gap diagnose NEW --reference IT then "
    "says what changed."
)


def protocol(
    context: typer.Context,
    arm: NominalArmOption = "cdsm_lab",
    model: ModelOption = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Also write commands and loads as rows of a recording, .csv."),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Print which poses, loads and holds to record, so that effects can be distinguished.

    Loads leave every cable of the nominal arm taut. Each block is one trial; take longer where
    hands need it, and keep the order.

    Example: cablesense gap protocol --arm my_arm.yaml --out protocol.csv
    """
    if model is None:
        _arm_protocol(arm, out, force)
    else:
        refuse_given(context, ["arm"], "with --model")
        _robot_protocol(model, out, force)


def _arm_protocol(arm: str, out: Path | None, force: bool) -> None:
    from cablesense_gap.recordings.csv_file import write_csv
    from cablesense_gap.recordings.protocol import rows_of, standard_protocol
    from cablesense_sim.arm import find_arm, load_arm

    arm_file = find_arm(arm)
    if out is not None:
        output_file(out, force=force, inputs=(arm_file,))
    description = load_arm(arm_file)
    blocks = standard_protocol(description)
    headings = ("trial", "at, s", "takes, s", "what", "what to do")
    table = titled_table(f"Protocol for arm {description.name}", *headings, right=headings[:3])
    table.columns[3].no_wrap = True
    at_s = 0.0
    for number, block in enumerate(blocks):
        times = (f"{at_s:.0f}", f"{block.duration_s:.0f}")
        table.add_row(str(number), *times, str(block.kind), block.does)
        at_s += block.duration_s
    console = Console()
    console.print(table)
    console.print(
        "Sides as seen along the arm from its base; places along a segment's axis from its joint "
        "centre. Record with: "
        f"cablesense gap record --arm {shlex.quote(arm)} --out recording.mcap\n{_KEEP_ONE}",
        style="dim",
        soft_wrap=True,
    )
    if out is not None:
        rows = rows_of(blocks, description.sensors.rate_hz)
        write_csv(out, rows)
        console.print(f"{out}: {len(rows):,} rows, {rows.time_s[-1]:.0f} s", soft_wrap=True)


def _robot_protocol(model: Path, out: Path | None, force: bool) -> None:
    from cablesense_gap.robot.amending import load_amended
    from cablesense_gap.robot.protocol import standard_protocol, write_protocol

    robot, _ = load_amended(model)
    if out is not None:
        output_file(out, force=force, inputs=(robot.path,))
    blocks = standard_protocol(robot)
    headings = ("trial", "takes, s", "what", "what to do")
    table = titled_table(f"Protocol for {robot.name}", *headings, right=headings[:2])
    for number, block in enumerate(blocks, start=1):
        table.add_row(str(number), f"{block.duration_s:.0f}", block.kind, block.does)
    console = Console()
    console.print(table)
    console.print(
        "Record position.<joint>, and torque.<joint> or command.<actuator>, at 100 Hz or more; "
        f"smaller ranges will do where there is no room.\n{_KEEP_ONE}",
        style="dim",
    )
    if out is not None:
        rows = write_protocol(out, robot, blocks)
        console.print(f"{out}: {rows:,} rows", soft_wrap=True)


def record(
    out: RecordingFile,
    duration: DurationOption = None,
    arm: Annotated[
        str | None,
        typer.Option(
            help="A bundled arm's name, or an arm file: what does not fit it is left out, and the "
            "recording is checked at the end."
        ),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Record tensions, commands and known loads from running nodes, as rosbag2 MCAP.

    Start it before the first command of the protocol. Ctrl-C ends it; the file is whole then.

    Example: cablesense gap record --arm my_arm.yaml --out recording.mcap
    """
    from cablesense_msgs_py.qos import INPUTS
    from cablesense_ros.recorder import record_topics
    from cablesense_sim.arm import open_arm

    description = None if arm is None else open_arm(arm)
    console = Console()
    record_topics(out, INPUTS, duration, description, console, force=force)
    if description is None:
        return
    from cablesense_gap.recordings.checks import check_recording, read_recording
    from cablesense_gap.recordings.thinning import rows_to_use
    from cablesense_sim.replay import replay_arm

    recording = read_recording(out, description)
    rows = rows_to_use(recording)
    used = recording.rows(rows)
    nominal_n = replay_arm(description.nominal, *used.inputs)
    for finding in check_recording(recording, description, nominal_n, rows):
        console.print(f"{finding.severity}: {finding.text}", soft_wrap=True, markup=False)
