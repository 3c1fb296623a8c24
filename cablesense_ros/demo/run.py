"""A demo from start to end: live with the page, or headless with a script and a report.

Where the demo's tensions come from: the sim node at once, or through CAN frames.

What moves the arm in a demo.
"""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from cablesense_base.errors import CableSenseError
from cablesense_online.page.exposure import exposure_warning
from cablesense_ros.demo.source import DEMO_MAP, Source, source_commands
from cablesense_ros.discovery import own_graph
from cablesense_ros.processes import Processes, node_command
from cablesense_sim.arm import Arm, open_arm

PAGE_START_S = 60.0
ESTIMATES_START_S = 60.0
"""Slow machines import for tens of seconds the first time."""
EXIT_TERMINATED = 128 + signal.SIGTERM


class DemoError(CableSenseError):
    """The demo ran and failed."""

    exit_code = 1


@dataclass(frozen=True)
class DemoOptions:
    """What the command's options say.

    Attributes:
        arm: name or path.
        model: name or path; empty for the arm's own.
        host, port: where the page is served.
        out: folder of logs and picture.
        seed: of pushes and noise.
        source: of the tensions.
    """

    arm: str
    model: str
    host: str
    port: int
    out: Path
    seed: int
    source: Source = Source.SIM


def run_live(options: DemoOptions) -> None:
    """Serves the page until Ctrl-C or SIGTERM.

    Raises:
        CableSenseError: a file is wrong.
        DemoError: a node died or did not start.
    """
    _check_files(options)
    page = node_command(
        "page",
        {"arm": options.arm, "host": options.host, "port": options.port, "home_at_start": True},
    )
    with _ended_by_signals(), _processes(options, {"page": page}) as processes:
        print("Starting the simulated arm, the estimator and the page …", flush=True)
        url = processes.wait_for_line("page", "page: ", PAGE_START_S)
        busy = "" if url.endswith(f":{options.port}") else f" (port {options.port} is busy)"
        warning = exposure_warning(options.host, int(url.rpartition(":")[2]), controls=True)
        if warning:
            print(f"Warning: {warning}.", flush=True)
        print(f"CableSense demo: open {url} in a browser{busy}; Ctrl-C ends it.", flush=True)
        processes.run_until_one_ends()


def run_headless(options: DemoOptions, *, duration_s: float, as_json: bool) -> None:
    """Plays a script of pushes, prints true against estimated, writes a picture.

    Raises:
        CableSenseError: a file is wrong.
        DemoError: a node died, or estimates never came.
    """
    from cablesense_ros.demo.script import make_script

    arm = _check_files(options)
    script = make_script(arm.segment_count, duration_s, options.seed)
    environment = own_graph()
    os.environ.update(environment)  # before rclpy is imported: this process joins the same domain
    from cablesense_online.page.snapshot import Level
    from cablesense_ros.demo.observer import Observer, play
    from cablesense_ros.demo.pictures import draw_picture
    from cablesense_ros.demo.script import as_json as figures
    from cablesense_ros.demo.script import push_results, results_table

    console = Console(stderr=as_json)
    with _ended_by_signals(), _processes(options, {}) as processes:
        observer = Observer(arm)
        try:
            with console.status("Starting the simulated arm and the estimator …"):
                _until(
                    processes,
                    lambda: observer.connected,
                    "simulator and estimator did not come up",
                )
                observer.command(script[0].command_rad)
                _until(
                    processes,
                    lambda: observer.snapshot().status.level is not Level.STALE,
                    "no estimate came",
                )
                _until(
                    processes,
                    lambda: observer.live.content_with("tare"),
                    "the estimator took no tare",
                )
            with _progress_bar(console, script[-1].end_s) as progress:
                record = play(observer, script, processes.check, progress)
        finally:
            observer.close()
    results = push_results(script, record)
    picture = options.out / "demo.png"
    with console.status("Drawing the picture …"):
        draw_picture(picture, observer.live.mechanism, record, results)
    if as_json:
        print(
            json.dumps(
                {"arm": arm.identity, **figures(results), "picture": str(picture)}, indent=2
            )
        )
    else:
        console.print(results_table(results))
        console.print(f"picture: {picture}", soft_wrap=True)
    silent = sum(1 for result in results if not result.sample_count)
    if silent:
        raise DemoError(
            f"no estimate came during {silent} of {len(results)} pushes; logs are in {options.out}"
        )


def _check_files(options: DemoOptions) -> Arm:
    """Reads arm and model before anything starts: a wrong file is one line, not a silent node."""
    from cablesense_training.inference.metadata import find_model
    from cablesense_training.inference.temporal_estimator import open_estimator

    arm = open_arm(options.arm)
    open_estimator(find_model(options.model or arm.name), arm)
    if options.source is Source.CAN:
        from cablesense_online.can.channel_map import open_channel_map

        open_channel_map(DEMO_MAP)[0].arranged(arm.cable_names)
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CableSenseError(
            f"the folder {options.out} cannot be made ({error.strerror}); give another --out"
        ) from error
    return arm


def _processes(options: DemoOptions, more: dict[str, list[str]]) -> Processes:
    commands = source_commands(options.source, options.arm, options.seed, options.out) | {
        "estimator": node_command("estimator", {"arm": options.arm, "model": options.model})
    }
    return Processes(commands | more, options.out / "logs", own_graph())


def _until(processes: Processes, true: Callable[[], bool], otherwise: str) -> None:
    processes.wait_until(
        true,
        ESTIMATES_START_S,
        f"{otherwise} within {ESTIMATES_START_S:g} s",
    )


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Ctrl-C and SIGTERM leave through the `with` statements, which end the children."""

    def terminate(*_: object) -> None:
        raise SystemExit(EXIT_TERMINATED)

    before = {
        signal.SIGINT: signal.signal(signal.SIGINT, signal.default_int_handler),
        signal.SIGTERM: signal.signal(signal.SIGTERM, terminate),
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _progress_bar(console: Console, length_s: float) -> Iterator[Callable[[float], None]]:
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("pushing the arm"),
        BarColumn(),
        TextColumn("{task.completed:.0f} of {task.total:.0f} s"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=length_s)
        yield lambda now_s: bar.update(task, completed=now_s)
