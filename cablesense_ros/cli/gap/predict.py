"""`cablesense gap predict`: what an arm's sensors would have read in a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def predict(
    recording: Annotated[
        Path, typer.Argument(help="A .csv file, a .mcap file or a rosbag2 folder.")
    ],
    out: Annotated[Path, typer.Option(help="CSV file for the recording's rows as predicted.")],
    arm: Annotated[
        str, typer.Option(help="Arm: a path, or the name of a bundled one; amended or nominal.")
    ] = "cdsm_lab",
) -> None:
    """Predict the tensions of a recording, without noise, from its commands and loads alone.

    Example: [bold]cablesense gap predict new.csv --arm diagnosis/arm.yaml --out new_predicted.csv\
[/bold]
    """
    from dataclasses import replace

    from rich.console import Console

    from cablesense_gap.recordings.csv_file import write_csv
    from cablesense_gap.recordings.reading import read_recording
    from cablesense_sim.arm_files import open_arm
    from cablesense_sim.replay import replay_arm

    described = open_arm(arm)
    recorded = read_recording(recording, described)
    console = Console()
    with console.status("predicting"):
        tensions_n = replay_arm(
            described, recorded.time_s, recorded.command_rad, recorded.forces_n
        )
    write_csv(out, replace(recorded, tensions_n=tensions_n))
    difference = recorded.tensions_n - tensions_n
    gap_n = float((difference**2).mean() ** 0.5)
    console.print(f"{out}: {len(recorded)} rows, {gap_n:.3f} N (RMS) from what was read")
