"""`cablesense demo`: the arm in simulation, the estimator and the live page, with one command."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cablesense_cli.options import refuse_given
from cablesense_ros.demo.run import Controller, DemoOptions, Source, run_headless, run_live


def demo(
    context: typer.Context,
    arm: Annotated[
        str, typer.Option(help="Arm file: the name of a bundled one, or a path.")
    ] = "cdsm",
    model: Annotated[
        str, typer.Option(help="Model file: a bundled name, or a path. Default: the arm's own.")
    ] = "",
    host: Annotated[
        str, typer.Option(help="Address of the page. 0.0.0.0 opens it to your network.")
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=1, max=65535, help="Port of the page; when busy, the next free one.")
    ] = 8080,
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
        Path, typer.Option(help="Folder for the headless picture and for the nodes' logs.")
    ] = Path("out/demo"),
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
    controller: Annotated[
        Controller,
        typer.Option(
            help="What moves the arm: nothing but you, or an admittance controller that yields to "
            "an elastic wall."
        ),
    ] = Controller.NONE,
    json_output: Annotated[
        bool, typer.Option("--json", help="With --headless: print the report as JSON.")
    ] = False,
) -> None:
    """Watch an arm being pushed, and the force estimated from its cables beside the true one.

    Starts the simulated arm, the estimator and a page in the browser where you can push the arm
    and move its joints. Ctrl-C ends all of it. With --headless it needs no browser: a script of
    pushes, or of the wall, runs for a minute.
    """
    options = DemoOptions(
        arm=arm,
        model=model,
        host=host,
        port=port,
        out=out,
        seed=seed,
        source=source,
        controller=controller,
    )
    if headless:
        refuse_given(context, ("host", "port"), "with --headless, which serves no page")
        run_headless(options, duration_s=duration, as_json=json_output)
    else:
        refuse_given(context, ("duration", "json_output"), "without --headless")
        run_live(options)
