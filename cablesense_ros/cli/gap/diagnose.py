"""`cablesense gap diagnose`: which effect makes a recorded arm differ from the simulated one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer


def diagnose(
    recording: Annotated[
        Path, typer.Argument(help="A .csv file, a .mcap file or a rosbag2 folder.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for verdict.json, report.html and arm.yaml.")],
    arm: Annotated[
        str, typer.Option(help="Nominal arm: a path, or the name of a bundled one.")
    ] = "cdsm_lab",
    workers: Annotated[int, typer.Option(min=1, max=64, help="Processes to use.")] = 2,
    retrain: Annotated[
        bool,
        typer.Option(
            "--retrain",
            help="Also train force estimators for both arms, and compare them on held-out loads; "
            "takes minutes.",
        ),
    ] = False,
) -> None:
    """Tell where the gap lies, which effect makes it, and how far it shrinks with that effect.

    Writes the verdict, a report to read, and an amended arm file that the sim, the training and
    `gap predict` take as they take any other.

    Example: [bold]cablesense gap diagnose recording.csv --arm my_arm.yaml --out diagnosis[/bold]
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from cablesense_gap.diagnose import diagnose as make
    from cablesense_gap.folder import write_diagnosis
    from cablesense_gap.recordings.reading import read_recording
    from cablesense_gap.report.wording import headline
    from cablesense_sim.arm_files import open_arm

    if retrain:  # what it needs is missed now rather than after the diagnosis
        from cablesense_gap.retraining import estimator_errors

    nominal = open_arm(arm)
    recorded = read_recording(recording, nominal)
    console = Console()
    columns = (TextColumn("{task.description:36}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("reading", total=1.0)

        def tell(doing: str, done: float) -> None:
            progress.update(task, description=doing.replace("_", " "), completed=done)

        found = make(recorded, nominal, tell, workers)
        if retrain:
            errors = estimator_errors(recorded, nominal, found.amended, tell, workers)
            verdict = found.verdict.model_copy(update={"estimator": errors})
            found = replace(found, verdict=verdict)
    write_diagnosis(out, recorded, nominal, found)
    console.print(headline(found.verdict), soft_wrap=True)
    console.print(f"Report: {out / 'report.html'}", soft_wrap=True)
