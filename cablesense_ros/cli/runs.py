"""Verbs that run nodes: `cablesense demo`, and `record` and `replay` of a run in a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cablesense_base.files import output_file, output_folder
from cablesense_ros.cli.options import (
    DurationOption,
    ForceOption,
    JsonOption,
    RecordingFile,
    print_json,
    refuse_given,
)
from cablesense_ros.demo import (
    AS_FILE,
    BUILT_SEED,
    DEMO_ARM,
    DEMO_FILES,
    DEMO_FOLDER,
    DemoOptions,
    Source,
    run_headless,
    run_live,
)
from cablesense_sim.machine.description import is_machine_file


def demo(
    context: typer.Context,
    arm: Annotated[
        str | None,
        typer.Option(
            help="Arm file: the name of a bundled one, or a path; or a machine file.",
            show_default="cdsm_lab; with --breathe cdsm_friction",
        ),
    ] = None,
    model: Annotated[
        str, typer.Option(help="Model file: a bundled name, or a path. Default: the arm's own.")
    ] = "",
    host: Annotated[
        str, typer.Option(help="Address of the page. 0.0.0.0 opens it to your network.")
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=1, max=65535, help="Port of the page; when busy, the next free one.")
    ] = 8080,
    no_open: Annotated[
        bool, typer.Option("--no-open", help="Do not open the page in your browser.")
    ] = False,
    headless: Annotated[
        bool,
        typer.Option(
            "--headless", help="No page: play a script, print a report, write a picture."
        ),
    ] = False,
    duration: Annotated[
        float,
        typer.Option(min=4.0, max=3600.0, help="With --headless: length of the script, seconds."),
    ] = 60.0,
    out: Annotated[
        Path,
        typer.Option(
            help="Folder for the headless picture and for the nodes' logs; those of the last demo "
            "in the default folder are replaced."
        ),
    ] = DEMO_FOLDER,
    force: ForceOption = False,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the pushes and of the sensor noise.")
    ] = 0,
    source: Annotated[
        Source,
        typer.Option(
            help="Where tensions come from: the simulation at once, or through CAN frames, an "
            "emulated adapter and the driver."
        ),
    ] = Source.SIM,
    breathe: Annotated[
        bool,
        typer.Option(
            "--breathe",
            help="The arm breathes all the time: cables slide a little at every guide, so that "
            "friction hides no force.",
        ),
    ] = False,
    built_seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Seed of the errors with which the arm was built, within its file's tolerances.",
            show_default=f"{BUILT_SEED}; with --breathe the arm equals its file",
        ),
    ] = None,
    as_file: Annotated[
        bool, typer.Option("--as-file", help="The arm equals its file, as no built arm does.")
    ] = False,
    no_commission: Annotated[
        bool,
        typer.Option(
            "--no-commission",
            help="Do not visit poses first, to learn how the arm was built: a tare must do.",
        ),
    ] = False,
    json_output: Annotated[
        bool, typer.Option("--json", help="With --headless: print the report as JSON.")
    ] = False,
) -> None:
    """Watch an arm or a machine being pushed, with the estimated force and the true one.

    Starts the simulated arm, the estimator and a page in the browser where you can push the arm
    and move its joints. The arm is not quite as its file says, like every built one; it first
    visits some poses by itself, untouched, to learn that. Ctrl-C ends all of it. With --headless
    it needs no browser: a script of pushes runs for a minute. A controller that gives way to
    pushes is examples/admittance.py.

    A machine file works likewise, with its links, without commissioning, breath and CAN frames.
    """
    output_folder(out, DEMO_FILES, force=force or out == DEMO_FOLDER)
    if as_file:
        refuse_given(context, ("built_seed",), "with --as-file, which has no errors")
    if built_seed is None:
        built_seed = AS_FILE if as_file or breathe else BUILT_SEED
    if arm is None:
        arm = "cdsm_friction" if breathe else DEMO_ARM
    if is_machine_file(arm):
        why = "of a machine file: what they do is for arms of arm files"
        refuse_given(context, ["source", "breathe", "no_commission"], why)
    options = DemoOptions(
        arm=arm,
        model=model,
        host=host,
        port=port,
        out=out,
        seed=seed,
        source=source,
        breathe=breathe,
        open_page=not no_open,
        built_seed=built_seed,
        commission=not no_commission,
    )
    if headless:
        page_options = ("host", "port", "no_open")
        refuse_given(context, page_options, "with --headless, which serves no page")
        run_headless(options, duration_s=duration, as_json=json_output)
    else:
        refuse_given(context, ("duration", "json_output"), "without --headless")
        run_live(options)


def record(
    out: RecordingFile,
    duration: DurationOption = None,
    namespace: Annotated[str, typer.Option(help="Namespace of the nodes.")] = "",
    force: ForceOption = False,
) -> None:
    """Record all topics of the contract from running nodes, as rosbag2 MCAP.

    Tensions, commands and loads, the estimates and what they rest on, diagnostics, joint
    states, the robot description. Opens in Foxglove and PlotJuggler, plays in `ros2 bag play`,
    and `cablesense replay` gives the same estimates again. A recorder that is killed loses half a
    second. Ctrl-C ends it.

    Example: cablesense record --out run.mcap
    """
    from rich.console import Console

    from cablesense_msgs_py.qos import RECORDED_TOPICS
    from cablesense_ros.recorder import record_topics

    record_topics(out, RECORDED_TOPICS, duration, None, Console(), namespace, force)


def replay(
    context: typer.Context,
    recording: Annotated[Path, typer.Argument(help="The .mcap file of `cablesense record`.")],
    arm: Annotated[
        str, typer.Option(help="Another arm than the recorded: a bundled name, or an arm file.")
    ] = "",
    model: Annotated[
        str, typer.Option(help="Another model than the recorded: a bundled name, or a path.")
    ] = "",
    estimates: Annotated[
        Path | None, typer.Option(help="Write the estimates to this .csv file.")
    ] = None,
    force: ForceOption = False,
    json_output: JsonOption = False,
) -> None:
    """Give a recording's estimates again, and compare them with the recorded ones bit by bit.

    Exit code 1 where one differs. With another arm or model it states how many stay the same, and
    --estimates writes the estimates of that model.

    Example: cablesense replay run.mcap
    """
    from dataclasses import asdict

    from cablesense_online.replay import RecordedRun, replay_in_process

    if estimates is None:
        refuse_given(context, ["force"], "without --estimates")
    else:
        output_file(estimates, force=force, inputs=(recording, arm, model))
    run = RecordedRun(recording)
    comparison = replay_in_process(run, arm, model, estimates)
    if json_output:
        print_json(asdict(comparison) | {"cut": run.cut})
    else:
        if run.cut:
            typer.echo(f"the file {run.cut}")
        typer.echo("\n".join(comparison.lines))
    if not (comparison.same or arm or model):
        raise typer.Exit(1)
