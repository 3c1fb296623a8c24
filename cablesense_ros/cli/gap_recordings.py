"""`cablesense gap …`: recordings to make, and of one machine over months."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import typer
from rich.console import Console

from cablesense_base.files import output_file, output_folder
from cablesense_base.progress import status
from cablesense_ros.cli.options import (
    DaskOption,
    DurationOption,
    EffortOption,
    ForceOption,
    JsonOption,
    ModelOption,
    NominalArmOption,
    RecordingFile,
    TopicsOption,
    WorkersOption,
    print_json,
    print_result,
    refuse_given,
    titled_table,
)

if TYPE_CHECKING:
    from cablesense_gap.robot.isolability import Isolability
    from cablesense_gap.verdict import Verdict

_Machine: TypeAlias = "tuple[Callable[[Path], Any], Callable[..., Verdict], Any]"
"""How to read a recording, how to diagnose one with a healthy one, and the model."""
_KEEP_ONE = (
    "Record one after commissioning, and keep it: cablesense gap diagnose NEW --reference IT then "
    "says what changed."
)


_TIMES = 5
"""How often each block for a question is recorded: trials are held out in five folds."""


def protocol(
    context: typer.Context,
    arm: NominalArmOption = "cdsm_lab",
    model: ModelOption = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Also write commands and loads as rows of a recording, .csv."),
    ] = None,
    channels: Annotated[
        Literal["torques", "commands", "external"],
        typer.Option(
            help="With --model: what will be recorded: torques, commands alone, or commands and "
            "positions measured outside the drives."
        ),
    ] = "torques",
    tell_apart: Annotated[
        tuple[str, str] | None,
        typer.Option(
            metavar="EFFECT EFFECT",
            help="With --model: instead of the usual motions, those in which two effects differ.",
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(help="With --model: also draw which effects differ, .svg or .png."),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Print what to record, so that effects can be distinguished, and which can be.

    Loads leave every cable of the nominal arm taut. Each block is one trial; take longer where
    hands need it, and keep the order. Of a robot, a table says from which size on a verdict would
    name each effect, and what it may be taken for.

    Example: cablesense gap protocol --arm my_arm.yaml --out protocol.csv
    """
    if model is None:
        refuse_given(context, ["channels", "tell_apart", "picture"], "without --model")
        _arm_protocol(arm, out, force)
    else:
        refuse_given(context, ["arm"], "with --model")
        if picture is not None:
            from cablesense_gap.report.isolability import picture_kind

            picture_kind(picture)
            output_file(picture, force=force, inputs=(model,))
        _robot_protocol(model, out, force, channels, tell_apart, picture)


def _arm_protocol(arm: str, out: Path | None, force: bool) -> None:
    from cablesense_gap.protocol import rows_of, standard_protocol
    from cablesense_recording.csv_file import write_csv
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


def _robot_protocol(
    model: Path,
    out: Path | None,
    force: bool,
    channels: Literal["torques", "commands", "external"],
    pair: tuple[str, str] | None,
    picture: Path | None,
) -> None:
    from cablesense_gap.robot.amending import load_amended
    from cablesense_gap.robot.isolability import blocks_that_part, isolability, planned
    from cablesense_gap.robot.protocol import standard_protocol, write_protocol

    robot, _ = load_amended(model)
    if out is not None:
        output_file(out, force=force, inputs=(robot.path,))
    title = f"Protocol for {robot.name}"
    times = 1
    if pair is None:
        blocks = standard_protocol(robot)
    else:
        title = f"To tell {pair[0]} from {pair[1]}, {robot.name}: each block {_TIMES} times"
        times = _TIMES
        blocks = blocks_that_part(robot, pair, channels)
    recorded = [block for block in blocks for _ in range(times)]
    plan_isolability = isolability(planned(robot, recorded, channels))
    headings = ("trial", "takes, s", "what", "what to do")
    table = titled_table(title, *headings, right=headings[:2])
    for number, block in enumerate(blocks, start=1):
        table.add_row(str(number), f"{block.duration_s:.0f}", block.kind, block.does)
    console = Console()
    console.print(table)
    if pair is not None and plan_isolability.may_confuse(*pair):
        console.print(
            f"No motion that was tried tells {pair[0]} from {pair[1]} at every place: a verdict "
            "would name both, as one group."
        )
    console.print(
        "Record position.<joint>, and torque.<joint> or command.<actuator>, at 100 Hz or more; "
        f"smaller ranges will do where there is no room.\n{_KEEP_ONE}",
        style="dim",
    )
    _print_isolability(console, plan_isolability)
    if picture is not None:
        from cablesense_gap.report.isolability import write_picture

        write_picture(picture, plan_isolability, robot.name)
        console.print(f"{picture}: which effects the planned motion tells apart")
    if out is not None:
        rows = write_protocol(out, robot, recorded)
        console.print(f"{out}: {rows:,} rows", soft_wrap=True)


def _print_isolability(console: Console, plan_isolability: Isolability) -> None:
    """From which size each effect is named, and which others a verdict may name instead."""
    headings = ("effect", "at", "named from", "may be taken for")
    table = titled_table("What this motion shows", *headings, right=headings[2:3])
    for number, site in enumerate(plan_isolability.sites):
        size = plan_isolability.named_from[number]
        shows = f"{size:.2g} {plan_isolability.units[number]}".removesuffix(" 1")
        imitators = ", ".join(plan_isolability.imitators(number)) or "–"
        if not math.isfinite(size):
            shows = "never"
            imitators = "none"
        table.add_row(site.effect, site.place, shows, imitators)
    console.print(table)
    console.print(
        f"{plan_isolability.compared} Sensors are taken to be usual ones: torques with 0.5 % of "
        "noise, encoders with 0.1 mrad, cameras with 1 mrad. An effect that may be taken for "
        "another is named with it, as one group: --tell-apart chooses motions in which the two "
        "differ.",
        style="dim",
    )


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
    from cablesense_recording.checks import check_recording
    from cablesense_recording.reading import read_recording
    from cablesense_recording.recording import rows_to_use
    from cablesense_sim.replay import replay_arm

    recording = read_recording(out, description)
    rows = rows_to_use(recording)
    used = recording.rows(rows)
    nominal_n = replay_arm(description.nominal, used.course)
    for finding in check_recording(recording, description, nominal_n, rows):
        what = "refuse" if finding.refuses else "warn"
        console.print(f"{what}: {finding.text}", soft_wrap=True, markup=False)


def watch(
    context: typer.Context,
    folder: Annotated[
        Path, typer.Argument(help="Recordings of one machine whose names begin with their dates.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for drift.csv and drift.png.")],
    arm: NominalArmOption = "cdsm_lab",
    model: ModelOption = None,
    topic: TopicsOption = None,
    effort: EffortOption = None,
    workers: WorkersOption = 2,
    dask_scheduler: DaskOption = None,
    force: ForceOption = False,
    json_output: JsonOption = False,
) -> None:
    """Show what drifts: each recording of a folder is diagnosed with the first as the reference.

    The first recording is that of the healthy machine, as after commissioning. A Dask cluster
    diagnoses as many recordings at a time as it has workers.

    Example: [bold]cablesense gap watch recordings --model robot.xml --out drift[/bold]
    """
    from cablesense_gap.watch import WATCH_FILES, series, write_drift

    if model is not None:
        refuse_given(context, ["arm"], "with --model")
    else:
        refuse_given(context, ["effort"], "without --model")
    if dask_scheduler is not None:
        refuse_given(context, ["workers"], "with --dask-scheduler")
    first, *later = series(folder)
    output_folder(out, WATCH_FILES, force=force, inputs=(first, *later))
    topics = topic or ()
    read, diagnosed, machine = (
        _of_robot(model, topics, effort or ()) if model else _of_arm(arm, topics)
    )
    console = Console(stderr=json_output)

    def read_and_told(path: Path) -> Any:
        recording = read(path)
        said = recording.notes if model is None else (*recording.notes, *recording.warnings)
        for each in said:
            console.print(f"{path.name}: {each}", soft_wrap=True, markup=False, highlight=False)
        return recording

    recordings = map(read_and_told, later)
    shared = (machine, read_and_told(first))
    incoming: Iterator[Verdict] = (diagnosed(*shared, each, workers) for each in recordings)
    if dask_scheduler is not None:
        from cablesense_training.cluster import map_on_cluster

        incoming = map_on_cluster(dask_scheduler, diagnosed, recordings, *shared)
    verdicts: list[Verdict] = []
    for path in later:
        with status(f"{path.name}, {len(verdicts) + 1} of {len(later)}"):
            verdicts.append(next(incoming))
    write_drift(out, verdicts)
    if json_output:
        print_json([each.model_dump(mode="json", exclude_none=True) for each in verdicts])
        return
    headings = ("recording", "what changed", "sure", "gap by the floor")
    table = titled_table(f"Since {first.name}", *headings, right=headings[2:])
    for path, verdict in zip(later, verdicts, strict=True):
        gap = verdict.gap
        what = " + ".join(verdict.effects).replace("_", " ")
        sure = f"{verdict.probability:.0%}"
        table.add_row(path.name, what, sure, f"{gap.before_n / gap.floor_n:.1f}")
    console.print(table)
    console.print(f"Numbers and picture: {out}", soft_wrap=True)


def _of_arm(arm: str, topics: Sequence[str]) -> _Machine:
    from cablesense_recording.reading import read_recording
    from cablesense_sim.arm import open_arm

    nominal = open_arm(arm)
    return partial(read_recording, arm=nominal, topics=topics), _arm_verdict, nominal


def _of_robot(model: Path, topics: Sequence[str], efforts: Sequence[str]) -> _Machine:
    from cablesense_gap.robot.amending import load_amended
    from cablesense_gap.robot.recording import read_robot_recording

    robot, beside = load_amended(model)
    read = partial(read_robot_recording, robot=robot, topics=topics, efforts=efforts)
    return read, _robot_verdict, (robot, beside)


def _arm_verdict(nominal: Any, healthy: Any, recorded: Any, workers: int = 1) -> Verdict:
    from cablesense_gap.arm_system import diagnose

    return diagnose(recorded, nominal, workers=workers, reference=healthy).verdict


def _robot_verdict(machine: Any, healthy: Any, recorded: Any, workers: int = 1) -> Verdict:
    from cablesense_gap.robot.system import diagnose

    robot, beside = machine
    return diagnose(recorded, robot, beside, workers=workers, reference=healthy).verdict


def score(
    verdicts: Annotated[
        Path,
        typer.Argument(
            metavar="DIR_OF_VERDICTS",
            help="Holds RECORDING/verdict.json, or RECORDING.json, for each row of the answers.",
        ),
    ],
    answers: Annotated[
        Path, typer.Option(help="CSV with recording, effects joined by +, and where.")
    ],
    json_output: JsonOption = False,
) -> None:
    """Score verdicts against answers: correct names, probabilities, calibration.

    Example: cablesense gap score verdicts --answers answers.csv --json
    """
    from cablesense_gap.scoring import read_answers, read_verdicts
    from cablesense_gap.scoring import score as score_verdicts

    listed = read_answers(answers)
    scores = score_verdicts(read_verdicts(verdicts, [a.recording for a in listed]), listed)
    print_result(f"{scores.cases} verdicts", asdict(scores), json_output)
