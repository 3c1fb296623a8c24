"""`cablesense record` and `cablesense replay`: a run of the nodes in a file, and once more."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cablesense_cli.options import refuse_given


def record(
    out: Annotated[Path, typer.Option(help="The .mcap file to write.")],
    duration: Annotated[
        float | None, typer.Option(min=0.1, help="Seconds to record.", show_default="until Ctrl-C")
    ] = None,
    namespace: Annotated[str, typer.Option(help="Namespace of the nodes.")] = "",
) -> None:
    """Record all topics of the contract from running nodes, as rosbag2 MCAP.

    Tensions, commands and loads, the estimates and the estimator's journal, diagnostics, joint
    states, the robot description. Opens in Foxglove and PlotJuggler, plays in `ros2 bag play`,
    and `cablesense replay` gives the same estimates again. A recorder that is killed loses half a
    second. Ctrl-C ends it.

    Example: cablesense record --out run.mcap
    """
    from rich.console import Console

    from cablesense_msgs_py.qos import CONTRACT
    from cablesense_ros.recorder import record_topics

    record_topics(out, CONTRACT, duration, None, Console(), namespace)


EXIT_DIFFERENT = 1


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
    publish: Annotated[
        bool,
        typer.Option("--publish", help="Publish the inputs over ROS, for an estimator that runs."),
    ] = False,
    rate: Annotated[
        float, typer.Option(min=0.01, max=100.0, help="With --publish: how many times as fast.")
    ] = 1.0,
    namespace: Annotated[str, typer.Option(help="With --publish: of the estimator.")] = "",
    json: Annotated[bool, typer.Option("--json", help="Print the counts as JSON.")] = False,
) -> None:
    """Give a recording's estimates again, and compare them with the recorded ones bit by bit.

    Exit code 1 where one differs. With another arm or model it says how many stay the same, and
    --estimates writes the estimates of that model.

    Example: cablesense replay run.mcap
    """
    from contextlib import nullcontext
    from functools import partial
    from json import dumps

    from cablesense_gap.recordings.recording import RecordingError
    from cablesense_online.recorded_run import RecordedRun
    from cablesense_online.replay import comparison_lines, estimate_table, replay_in_process

    if publish and (arm or model or estimates):
        raise RecordingError(
            "--publish: the estimator that runs has its own arm and model, and publishes its "
            "estimates; leave out --arm, --model and --estimates"
        )
    if not publish:
        refuse_given(context, ("rate", "namespace"), "without --publish")
    run = RecordedRun(recording)
    if publish:
        from cablesense_ros.replay_through_node import replay_through_node

        say = partial(typer.echo, err=True)
        comparison = replay_through_node(run, rate, namespace, say)
    else:
        with nullcontext() if estimates is None else estimate_table(estimates) as table:
            comparison = replay_in_process(run, arm, model, table)
    if json:
        typer.echo(dumps(comparison.as_json() | {"cut": run.cut}))
    else:
        for line in comparison_lines(comparison, run.cut):
            typer.echo(line)
    if not (comparison.same or arm or model):
        raise typer.Exit(EXIT_DIFFERENT)
