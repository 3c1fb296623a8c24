"""`python -m cablesense_plants`: recordings of machines in which something is hidden."""

from __future__ import annotations

from collections.abc import Iterator
from glob import escape
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import track

from cablesense_base.files import output_folder
from cablesense_ros.cli.app import run_app
from cablesense_ros.cli.options import ForceOption, NominalArmOption, WorkersOption, refuse_given


def blind_cases(
    context: typer.Context,
    count: Annotated[int, typer.Option(min=1, max=10_000, help="How many recordings.")],
    out: Annotated[Path, typer.Option(help="Folder for case_001.csv ….")],
    seed: Annotated[int, typer.Option(min=0, help="The same seed makes the same files.")] = 0,
    arm: NominalArmOption = "cdsm_lab",
    model: Annotated[
        Path | None,
        typer.Option(
            help="In place of --arm: MJCF or URDF of a robot whose joints are a row of hinges."
        ),
    ] = None,
    answers: Annotated[
        Path | None, typer.Option(help="File for the answers, if not OUT/answers/answers.csv.")
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            help="Hide only this: none, unknown, an effect's name, or several joined by +. "
            "Repeatable; they come in turn."
        ),
    ] = None,
    second: Annotated[
        bool,
        typer.Option(
            "--second", help="Record every machine twice, the second time in OUT/second/."
        ),
    ] = False,
    plain: Annotated[
        bool,
        typer.Option(
            "--plain",
            help="Of arms: hide what stands out of their tolerances, with gaps of some 60 to 100 "
            "times the error of a reading.",
        ),
    ] = False,
    workers: WorkersOption = 1,
    force: ForceOption = False,
) -> None:
    """Make recordings of arms in which something is hidden, or nothing, and a file of answers.

    The arms come from a plant that shares no code with the simulator or the diagnosis; so do other
    robots, given their --model. Every machine has manufacturing tolerances; a fifth hides nothing
    more, a fifth something that no verdict has a name for, some two or more effects at once.

    Examples: [bold]python -m cablesense_plants --count 60 --seed 7 --out cases[/bold],
    [bold]python -m cablesense_plants --count 1 --only payload --model robot.xml --out cases[/bold]
    """
    from cablesense_sim.arm import find_arm

    if model is not None:
        refuse_given(context, ["arm", "plain", "workers"], "with --model")
    answers_file = answers or out / "answers" / "answers.csv"
    kinds = tuple(only or ())
    names = "case_*.csv" if model is None else "case_*.csv.gz"
    written = (names, f"second/{names}") if second else (names,)
    source = find_arm(arm) if model is None else model
    output_folder(out, written, force=force, inputs=(source,))
    output_folder(answers_file.parent, (escape(answers_file.name),), force=force, inputs=(source,))
    made: Iterator[object]
    if model is None:
        from cablesense_plants.arm.blind_cases import record_cases as record_arms
        from cablesense_plants.arm.body import read_nominal

        nominal = read_nominal(source)
        made = record_arms(
            out, answers_file, nominal, count, seed, kinds, workers, second=second, plain=plain
        )
    else:
        from cablesense_gap.robot.model import load_robot
        from cablesense_plants.robot.cases import record_cases as record_robots

        read = load_robot(model).model
        made = record_robots(out, answers_file, model, read, count, seed, kinds, second=second)
    console = Console()
    for _ in track(made, description="Recording", total=count, console=console):
        pass
    console.print(f"{count} recordings in {out}, the answers in {answers_file}", soft_wrap=True)


app = typer.Typer(rich_markup_mode="rich", add_completion=False)
app.command()(blind_cases)

if __name__ == "__main__":
    run_app(app, "python -m cablesense_plants")
