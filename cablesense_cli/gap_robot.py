"""What `cablesense gap …` does with `--model`: any robot that MuJoCo loads, not the arm."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from cablesense_base.files import output_file, output_folder
from cablesense_cli.options import print_json, task_bars

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


def diagnose_robot(
    recording: Path,
    model: Path,
    out: Path,
    bandwidth_hz: float | None,
    workers: int,
    *,
    force: bool,
    json_output: bool,
) -> None:
    """`gap diagnose --model`."""
    from cablesense_robot.amending import load_amended
    from cablesense_robot.pipeline import diagnose
    from cablesense_robot.recording import read_recording
    from cablesense_robot.report import ROBOT_FILES, robot_headline, write_robot_diagnosis

    robot, beside = load_amended(model)
    output_folder(out, ROBOT_FILES, force=force, inputs=(recording, robot.path))
    recorded = read_recording(recording, robot)
    console = Console(stderr=json_output)
    with task_bars(console) as progress:
        task = progress.add_task("reading", total=1.0)

        def show(doing: str, done: float) -> None:
            progress.update(task, description=doing.replace("_", " "), completed=done)

        found = diagnose(recorded, robot, beside, bandwidth_hz, show, workers)
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
    bandwidth_hz: float | None,
    *,
    force: bool,
    json_output: bool,
) -> None:
    """`gap predict --model`."""
    from cablesense_robot.amending import load_amended
    from cablesense_robot.prediction import predicted, write_prediction
    from cablesense_robot.recording import read_recording

    robot, beside = load_amended(model)
    output_file(out, force=force, inputs=(recording, robot.path))
    found = predicted(read_recording(recording, robot), robot, beside, bandwidth_hz)
    write_prediction(out, found)
    if json_output:
        gaps = {name: gap for name, _, gap, _ in found.gaps}
        print_json({"out": str(out), "rows": len(found.time_s), "gap": gaps})
        return
    sizes = ", ".join(
        f"{name} {gap:.3g} of {size:.3g} {unit}" for name, unit, gap, size in found.gaps
    )
    Console().print(
        f"{out}: {len(found.time_s)} rows at a bandwidth of {found.bandwidth_hz:.3g} Hz; RMS from "
        f"what was measured, of its RMS: {sizes}",
        soft_wrap=True,
    )
