"""`cablesense gap watch`: a machine's recordings over months, each against the first."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from cablesense_base.files import output_folder
from cablesense_ros.cli.options import (
    ForceOption,
    JsonOption,
    ModelOption,
    NominalArmOption,
    WorkersOption,
    refuse_given,
)
from cablesense_ros.cli.results import print_json, titled_table

if TYPE_CHECKING:
    from cablesense_gap.verdict import Verdict


def watch(
    context: typer.Context,
    folder: Annotated[
        Path, typer.Argument(help="Recordings of one machine whose names begin with their dates.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for drift.csv and drift.png.")],
    arm: NominalArmOption = "cdsm_lab",
    model: ModelOption = None,
    workers: WorkersOption = 2,
    force: ForceOption = False,
    json_output: JsonOption = False,
) -> None:
    """Show what drifts: each recording of a folder is diagnosed with the first as the reference.

    The first recording is that of the healthy machine, as after commissioning.

    Example: [bold]cablesense gap watch recordings --model robot.xml --out drift[/bold]
    """
    from cablesense_gap.watch import WATCH_FILES, series, write_drift

    if model is not None:
        refuse_given(context, ["arm"], "with --model")
    paths = series(folder)
    output_folder(out, WATCH_FILES, force=force, inputs=paths)
    diagnosed = _of_arm(arm, workers) if model is None else _of_robot(model, workers)
    console = Console(stderr=json_output)
    verdicts: list[Verdict] = []
    for path in paths[1:]:
        with console.status(f"{path.name}, {len(verdicts) + 1} of {len(paths) - 1}"):
            verdicts.append(diagnosed(path, paths[0]))
    write_drift(out, verdicts)
    if json_output:
        print_json([each.model_dump(mode="json", exclude_none=True) for each in verdicts])
        return
    headings = ("recording", "what changed", "sure", "gap by the floor")
    table = titled_table(f"Since {paths[0].name}", *headings, right=headings[2:])
    for path, verdict in zip(paths[1:], verdicts, strict=True):
        gap, what = verdict.gap, " + ".join(verdict.effects).replace("_", " ")
        sure = f"{verdict.probability:.0%}"
        table.add_row(path.name, what, sure, f"{gap.before_n / gap.floor_n:.1f}")
    console.print(table)
    console.print(f"Numbers and picture: {out}", soft_wrap=True)


def _of_arm(arm: str, workers: int) -> Callable[[Path, Path], Verdict]:
    from cablesense_gap.arm_system import diagnose
    from cablesense_gap.recordings.checks import read_recording
    from cablesense_sim.arm import open_arm

    nominal = open_arm(arm)

    def diagnosed(path: Path, first: Path) -> Verdict:
        recorded, healthy = (read_recording(each, nominal) for each in (path, first))
        return diagnose(recorded, nominal, workers=workers, reference=healthy).verdict

    return diagnosed


def _of_robot(model: Path, workers: int) -> Callable[[Path, Path], Verdict]:
    from cablesense_gap.robot.amending import load_amended
    from cablesense_gap.robot.recording import read_recording
    from cablesense_gap.robot.system import diagnose

    robot, beside = load_amended(model)

    def diagnosed(path: Path, first: Path) -> Verdict:
        recorded, healthy = (read_recording(each, robot) for each in (path, first))
        return diagnose(recorded, robot, beside, workers=workers, reference=healthy).verdict

    return diagnosed
