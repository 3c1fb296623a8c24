"""`cablesense gap record`: the topics of a running arm into one file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def record(
    out: Annotated[Path, typer.Option(help="The .mcap file to write.")],
    duration: Annotated[
        float | None,
        typer.Option(min=0.1, help="Seconds to record.", show_default="until Ctrl-C"),
    ] = None,
    arm: Annotated[
        str | None,
        typer.Option(
            help="A bundled arm's name, or an arm file: what does not fit it is left out, and the "
            "recording is checked at the end.",
        ),
    ] = None,
) -> None:
    """Record tensions, commands and known loads from running nodes, as rosbag2 MCAP.

    Start it before the first command of the protocol. Ctrl-C ends it; the file is whole then.

    Example: cablesense gap record --arm my_arm.yaml --out recording.mcap
    """
    from rich.console import Console

    from cablesense_msgs_py.topic_types import INPUTS
    from cablesense_ros.recording_session import record_topics
    from cablesense_sim.arm_files import open_arm

    description = None if arm is None else open_arm(arm)
    console = Console()
    record_topics(out, INPUTS, duration, description, console)
    if description is None:
        return
    from cablesense_gap.recordings.checks import check_recording
    from cablesense_gap.recordings.reading import read_recording
    from cablesense_sim.equilibrium import solve_equilibrium
    from cablesense_sim.mechanism import Mechanism

    recording = read_recording(out, description)
    nominal = solve_equilibrium(
        Mechanism.from_arm(description), recording.command_rad, recording.forces_n
    )
    report = check_recording(recording, description, nominal.tensions_n)
    for finding in report.findings:
        console.print(f"{finding.severity}: {finding.text}", soft_wrap=True, markup=False)
