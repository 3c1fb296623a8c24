"""What `cablesense gap …` does with `--model`: any robot that MuJoCo loads, not the arm."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, NamedTuple

import typer
from rich.console import Console

from cablesense_base.files import output_file, output_folder
from cablesense_ros.cli.options import diagnosis_progress, print_json, titled_table

ModelOption = Annotated[
    Path | None,
    typer.Option(
        help="In place of --arm: MJCF or URDF of any robot with hinges and slides on a fixed "
        "base, or the folder of its diagnosis."
    ),
]
BandwidthOption = Annotated[
    float | None,
    typer.Option(
        help="With --model: hertz up to which motion and torques are compared.",
        show_default="as wide as noise lets it be",
    ),
]
ForwardOption = Annotated[
    bool | None,
    typer.Option(
        "--forward/--inverse",
        help="With --model: compare motion, forward in time over short windows, or the torques "
        "that motion needs.",
        show_default="forward where commands and no torques are recorded",
    ),
]
ZeroedOption = Annotated[
    bool,
    typer.Option(
        "--zeroed",
        help="With --model: encoders were set to zero where each trial begins, wherever that was.",
    ),
]


class ComparisonOptions(NamedTuple):
    """How a robot's recording is compared with its model, as the options say."""

    bandwidth_hz: float | None
    forward: bool | None
    zeroed: bool


def diagnose_robot(
    recording: Path,
    model: Path,
    out: Path,
    comparison: ComparisonOptions,
    workers: int,
    force: bool,
    json_output: bool,
) -> None:
    """`gap diagnose --model`."""
    from cablesense_gap.robot.amending import load_amended
    from cablesense_gap.robot.recording import read_recording
    from cablesense_gap.robot.report import ROBOT_FILES, robot_headline, write_robot_diagnosis
    from cablesense_gap.robot.system import diagnose

    robot, beside = load_amended(model)
    output_folder(out, ROBOT_FILES, force=force, inputs=(recording, robot.path))
    recorded = read_recording(recording, robot)
    console = Console(stderr=json_output)
    bandwidth_hz, forward, zeroed = comparison
    with diagnosis_progress(console) as progress:
        found = diagnose(
            recorded, robot, beside, bandwidth_hz, progress.show, workers, forward, zeroed=zeroed
        )
    write_robot_diagnosis(out, found, beside)
    if json_output:
        print_json(found.verdict.model_dump(mode="json", exclude_none=True))
        return
    for finding in found.findings:
        console.print(finding, soft_wrap=True, markup=False)
    console.print(robot_headline(found.verdict), soft_wrap=True)
    console.print(f"Report: {out / 'report.html'}", soft_wrap=True)


def predict_robot(
    recording: Path,
    model: Path,
    out: Path,
    comparison: ComparisonOptions,
    force: bool,
    json_output: bool,
) -> None:
    """`gap predict --model`."""
    from cablesense_gap.robot.amending import load_amended
    from cablesense_gap.robot.prediction import predicted, write_prediction
    from cablesense_gap.robot.recording import read_recording

    robot, beside = load_amended(model)
    output_file(out, force=force, inputs=(recording, robot.path))
    recorded = read_recording(recording, robot)
    bandwidth_hz, forward, zeroed = comparison
    found = predicted(recorded, robot, beside, bandwidth_hz, forward, zeroed=zeroed)
    write_prediction(out, found)
    if json_output:
        gaps = {name: gap for name, _, gap, _ in found.gaps}
        print_json({"out": str(out), "rows": len(found.predicted), "gap": gaps})
        return
    sizes = ", ".join(
        f"{name} {gap:.3g} of {size:.3g} {unit}" for name, unit, gap, size in found.gaps
    )
    Console().print(
        f"{out}: {found.comparison.description} Gap, of what was measured (RMS): {sizes}",
        soft_wrap=True,
    )


def print_robot_protocol(model: Path, out: Path | None, force: bool) -> None:
    """`gap protocol --model`."""
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
        "smaller ranges will do where there is no room.",
        style="dim",
    )
    if out is not None:
        rows = write_protocol(out, robot, blocks)
        console.print(f"{out}: {rows:,} rows", soft_wrap=True)
