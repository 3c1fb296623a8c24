"""`cablesense gap …`: a recording of the real arm against the simulated one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from cablesense_base.files import output_file, output_folder
from cablesense_ros.cli.adapt import adapt
from cablesense_ros.cli.blind import score, withhold
from cablesense_ros.cli.gap_robot import (
    BandwidthOption,
    ComparisonOptions,
    ForwardOption,
    ModelOption,
    ZeroedOption,
    diagnose_robot,
    predict_robot,
    print_robot_protocol,
)
from cablesense_ros.cli.options import (
    DurationOption,
    ForceOption,
    JsonOption,
    NominalArmOption,
    RecordingArgument,
    RecordingFile,
    WorkersOption,
    diagnosis_progress,
    print_json,
    refuse_given,
    titled_table,
)


def diagnose(
    context: typer.Context,
    recording: RecordingArgument,
    out: Annotated[
        Path, typer.Option(help="Folder for verdict.json, report.html and amended_arm.yaml.")
    ],
    arm: NominalArmOption = "cdsm_lab",
    model: ModelOption = None,
    bandwidth: BandwidthOption = None,
    forward: ForwardOption = None,
    zeroed: ZeroedOption = False,
    workers: WorkersOption = 2,
    force: ForceOption = False,
    json_output: JsonOption = False,
) -> None:
    """Find where the gap lies, which effect causes it, and how far it shrinks with that effect.

    Writes the verdict, a report to read, and an amended arm file that the sim, the training and
    `gap predict` take as they take any other. For another robot, give its --model; the recording
    then has columns position.<joint>, and torque.<joint> or command.<actuator>, and the model is
    amended.

    Examples: [bold]cablesense gap diagnose recording.csv --arm my_arm.yaml --out diagnosis[/bold],
    [bold]cablesense gap diagnose recording.csv --model robot.xml --out diagnosis[/bold]
    """
    if model is not None:
        refuse_given(context, ["arm"], "with --model")
        comparison = ComparisonOptions(bandwidth, forward, zeroed)
        diagnose_robot(recording, model, out, comparison, workers, force, json_output)
        return
    refuse_given(context, ["bandwidth", "forward", "zeroed"], "without --model")
    from cablesense_gap.arm_system import diagnose as make
    from cablesense_gap.recordings.checks import read_recording
    from cablesense_gap.report.page import DIAGNOSIS_FILES, write_diagnosis
    from cablesense_gap.report.text import earlier_sentence, headline
    from cablesense_sim.arm import find_arm, load_arm

    arm_file = find_arm(arm)
    output_folder(out, DIAGNOSIS_FILES, force=force, inputs=(recording, arm_file))
    nominal = load_arm(arm_file)
    recorded = read_recording(recording, nominal)
    console = Console(stderr=json_output)
    with diagnosis_progress(console) as progress:
        found = make(recorded, nominal, progress.show, workers, progress.warn)
    write_diagnosis(out, found)
    if json_output:
        print_json(found.verdict.model_dump(mode="json", exclude_none=True))
        return
    console.print(headline(found.verdict), soft_wrap=True)
    for earlier in found.verdict.earlier:
        console.print(earlier_sentence(earlier), soft_wrap=True, highlight=False)
    if len(found.recording) < len(recorded):
        console.print(f"Used: {len(found.recording):,} of {len(recorded):,} rows")
    console.print(f"Report: {out / 'report.html'}", soft_wrap=True)


def predict(
    context: typer.Context,
    recording: RecordingArgument,
    out: Annotated[Path, typer.Option(help="CSV file for the recording's rows as predicted.")],
    arm: Annotated[
        str,
        typer.Option(
            help="Arm, amended or nominal: a path, the folder of a diagnosis, or the name of a "
            "bundled one."
        ),
    ] = "cdsm_lab",
    model: ModelOption = None,
    bandwidth: BandwidthOption = None,
    forward: ForwardOption = None,
    zeroed: ZeroedOption = False,
    settle: Annotated[
        int,
        typer.Option(
            min=0,
            help="Estimate the initial state from this many first rows: plays, friction states, "
            "creep, zeros that drift.",
        ),
    ] = 0,
    force: ForceOption = False,
    json_output: JsonOption = False,
) -> None:
    """Predict the tensions of a recording, without noise, from its commands and loads alone.

    With --settle the first rows are read too, since friction and creep depend on the past.

    Example: [bold]cablesense gap predict new.csv --arm diagnosis --out new_predicted.csv[/bold]
    """
    if model is not None:
        refuse_given(context, ["arm", "settle"], "with --model")
        comparison = ComparisonOptions(bandwidth, forward, zeroed)
        predict_robot(recording, model, out, comparison, force, json_output)
        return
    refuse_given(context, ["bandwidth", "forward", "zeroed"], "without --model")
    from cablesense_base import CableSenseError
    from cablesense_gap.amended_arm import find_amended
    from cablesense_gap.arm_simulator import counted_rows, settled
    from cablesense_gap.recordings.checks import read_recording
    from cablesense_gap.recordings.csv_file import write_csv
    from cablesense_sim.arm import load_arm
    from cablesense_sim.replay import replay_arm

    arm_file = find_amended(arm)
    output_file(out, force=force, inputs=(recording, arm_file))
    described = load_arm(arm_file)
    recorded = read_recording(recording, described)
    if settle >= len(recorded):
        raise CableSenseError(
            f"--settle {settle}: {recording} has {len(recorded)} rows; leave some to predict"
        )
    console = Console(stderr=json_output)
    with console.status("predicting"):
        described = settled(described, recorded, settle)
        tensions_n = replay_arm(
            described, recorded.time_s, recorded.command_rad, recorded.forces_n
        )
    write_csv(out, replace(recorded, tensions_n=tensions_n))
    counted = counted_rows(described, recorded, tensions_n)
    counted[:settle] = False
    rows, judged = len(recorded), int(counted.sum())
    difference_n = (recorded.tensions_n - tensions_n)[counted]
    gap_n = float((difference_n**2).mean() ** 0.5) if judged else None
    if json_output:
        sizes = {"rows": rows, "settled": settle, "rows_counted": judged, "gap_n": gap_n}
        print_json({"out": str(out), **sizes})
        return
    size = "no row counts" if gap_n is None else f"{gap_n:.3f} N (RMS) from what was read"
    console.print(f"{out}: {rows} rows, {size}", soft_wrap=True)
    if settle:
        console.print(f"Not counted: the first {settle}, that the state was estimated from")
    if other := rows - settle - judged:
        console.print(
            f"Not counted: {other} rows, where cables are slack and several rests are possible"
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
    if model is not None:
        refuse_given(context, ["arm"], "with --model")
        if out is None:
            refuse_given(context, ["force"], "without --out")
        print_robot_protocol(model, out, force)
        return
    from cablesense_gap.recordings.protocol import rows_of, standard_protocol
    from cablesense_sim.arm import find_arm, load_arm

    arm_file = find_arm(arm)
    if out is None:
        refuse_given(context, ["force"], "without --out")
    else:
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
        "Sides as seen along the arm from its base. Record with: cablesense gap record "
        "--out recording.mcap",
        style="dim",
    )
    if out is not None:
        from cablesense_gap.recordings.csv_file import write_csv

        rows = rows_of(blocks, description.sensors.rate_hz)
        write_csv(out, rows)
        console.print(f"{out}: {len(rows):,} rows, {rows.time_s[-1]:.0f} s")


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
    from cablesense_sim.build import mechanism_of
    from cablesense_sim.equilibrium import solve_equilibrium

    recording = read_recording(out, description)
    rows = rows_to_use(recording)
    used = recording.rows(rows)
    nominal = solve_equilibrium(mechanism_of(description), used.command_rad, used.forces_n)
    for finding in check_recording(recording, description, nominal.tensions_n, rows):
        console.print(f"{finding.severity}: {finding.text}", soft_wrap=True, markup=False)


gap = typer.Typer(
    name="gap",
    help="Diagnoses the gap between a recorded arm and the simulated one: where it lies, "
    "which effect causes it, how far it shrinks once that effect is simulated.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)
for verb in (diagnose, adapt, predict, protocol, record, score, withhold):
    gap.command()(verb)
