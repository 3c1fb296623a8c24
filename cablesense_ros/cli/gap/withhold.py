"""`cablesense gap withhold`: recordings of arms with hidden effects, to try the diagnosis on."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def withhold(
    count: Annotated[int, typer.Option(min=1, max=10_000, help="How many recordings.")],
    out: Annotated[Path, typer.Option(help="Folder for case_001.csv ….")],
    seed: Annotated[int, typer.Option(min=0, help="The same seed makes the same files.")] = 0,
    arm: Annotated[
        str, typer.Option(help="Nominal arm: a path, or the name of a bundled one.")
    ] = "cdsm_lab",
    answers: Annotated[
        Path | None,
        typer.Option(help="File for what is hidden, if not OUT/answers/answers.csv."),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            help="Hide only this: none, unknown, an effect's name, or several joined by +. "
            "Repeatable; they come in turn."
        ),
    ] = None,
    workers: Annotated[int, typer.Option(min=1, max=256, help="Processes to use.")] = 1,
) -> None:
    """Make recordings of arms in which something is hidden, or nothing, and a file of answers.

    The arms come from a plant that shares no code with the simulator or the diagnosis. Every arm
    has a workshop's scatter; a fifth hides nothing more, a fifth something that no verdict has a
    name for, some two effects at once.

    Examples: [bold]cablesense gap withhold --count 60 --seed 7 --out cases[/bold],
    [bold]cablesense gap withhold --count 10 --only payload --out payloads[/bold]
    """
    from rich.console import Console
    from rich.progress import track

    from cablesense_gap.plant.nominal import read_nominal
    from cablesense_gap.plant.withhold import withhold as make
    from cablesense_sim.arm_files import find_arm

    answers_file = answers or out / "answers" / "answers.csv"
    console = Console()
    made = make(
        out, answers_file, read_nominal(find_arm(arm)), count, seed, tuple(only or ()), workers
    )
    for _ in track(made, description="Recording", total=count, console=console):
        pass
    console.print(f"{count} recordings in {out}, what is hidden in {answers_file}", soft_wrap=True)
