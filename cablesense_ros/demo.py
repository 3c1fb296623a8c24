"""A demo from start to end: live with the page, or headless with a script and a report."""

from __future__ import annotations

import json
import math
import os
import sys
import time
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from rich.console import Console

from cablesense_base import CableSenseError
from cablesense_base.progress import status, task_bars
from cablesense_msgs_py import topics
from cablesense_ros.processes import Processes, node_command, own_graph
from cablesense_sim.arm import open_arm
from cablesense_sim.machine.description import is_machine_file

if TYPE_CHECKING:
    from rclpy.node import Node

    from cablesense_online.models import Loaded
    from cablesense_online.page.live_machine import LiveMachine
    from cablesense_ros.demo_pushes import PushRecord, ScriptedPush

_MAP = "twelve_channel_amplifier"
"""The amplifier that the emulator poses as."""
_BITRATE_BIT_S = 1_000_000
"""Of the bus of the demo: the fastest of classical CAN."""
_START_S = 120.0
"""Slow machines import and compile for a minute the first time."""
_JOINT_SPEED_RAD_S = math.radians(20.0)
"""That of the nodes."""
_REST_S = 1.0
"""From a command to a breath or a commissioning: a move of the demo has nearly ended then."""
_LEAST_RATE_HZ = 50.0
"""The sensors of slower arms are read this often, as a page at 5 Hz looks broken; and those of
machines, whose files state no rate."""
_POSES = 8
"""Those of the commissioning: what a person waits for."""
_COMMISSIONING_S = 300.0
"""It takes half a minute, where other work keeps no processor busy."""
_ASK_EVERY_S = 0.2
"""How often a node is asked whether it is ready."""


class Source(StrEnum):
    """The source of the demo's tensions."""

    SIM = "sim"
    CAN = "can"


class DemoError(CableSenseError):
    """The demo ran and failed."""

    exit_code = 1


DEMO_ARM = "cdsm_lab"
"""A laboratory arm: what holes a tenth of a millimetre off do to it shows, and it can be learnt.

On `cdsm`, a hundred times as stiff, they slacken cables as soon as the arm bends.
"""
BUILT_SEED = 7
"""Of the demo's arm, one of many."""
AS_FILE = -1
"""In place of a seed: the arm equals its file."""
DEMO_FOLDER = Path("out/demo")
DEMO_FILES = ("demo.png", "logs/*.log")
"""The files of a demo in its folder."""


@dataclass(frozen=True)
class DemoOptions:
    """The command's options: an empty `model` is the arm's own, `out` holds logs and picture.

    The arm has errors within its file's tolerances, by `built_seed`, or `AS_FILE` none. It is
    commissioned before it is pushed, unless it breathes all the time, has a network's model, or is
    a machine whose joints are measured: nothing here commands those. `arm` may be the path of a
    machine's file.
    """

    arm: str = DEMO_ARM
    model: str = ""
    host: str = "127.0.0.1"
    port: int = 8080
    out: Path = DEMO_FOLDER
    seed: int = 0
    source: Source = Source.SIM
    breathe: bool = False
    open_page: bool = False
    built_seed: int = BUILT_SEED
    commission: bool = True


def run_live(options: DemoOptions) -> None:
    """Serve the page until it is interrupted.

    Raises:
        CableSenseError: a file is wrong, or a node ended or did not start.
    """
    from cablesense_online.page.guard import exposure_warning
    from cablesense_online.page.opened import shown_machine

    options, _ = _checked(options)
    shown_machine(options.arm)  # on a fresh computer it compiles; in the nodes nobody sees why
    with _nodes(options, live=True) as processes:
        print(f"Starting {', '.join(processes)} …", flush=True)
        url = processes.wait_for_line("page", "page: ", _START_S)
        port = urlsplit(url).port or 0
        if warning := exposure_warning(options.host, port, controls=True):
            print(f"Warning: {warning}.", flush=True)
        busy = "" if port == options.port else f" (port {options.port} is busy)"
        print(f"CableSense demo: open {url} in a browser{busy}; Ctrl-C ends it.", flush=True)
        if options.open_page:
            _open_in_browser(url)
        processes.wait_until(lambda: None, math.inf, "the demo ended")


def run_headless(options: DemoOptions, *, duration_s: float, as_json: bool) -> None:
    """Play a script of pushes; print a report, draw a picture.

    Raises:
        CableSenseError: a file is wrong, a node ended, or no estimates came.
    """
    from cablesense_online.page.live_machine import LiveMachine
    from cablesense_online.page.opened import shown_machine
    from cablesense_ros import demo_pushes

    options, loaded = _checked(options)
    os.environ.update(own_graph())  # before rclpy starts: this process joins the same domain
    console = Console(stderr=as_json)
    shown = shown_machine(options.arm)
    touched_m = shown.unobstructed_m
    most_along = demo_pushes.MOST_ALONG
    if loaded.law is None:  # a network estimates contacts at these points alone
        touched_m = shown.usual_m[:, None].repeat(2, axis=1)
        most_along = 0.0
    script = demo_pushes.make_script(shown, touched_m, duration_s, options.seed, most_along)
    live = LiveMachine(shown, joint_speed_rad_s=_JOINT_SPEED_RAD_S)
    played = _played(options, script, live, console)
    results = demo_pushes.push_results(script, played)
    picture = options.out / "demo.png"
    with status("Drawing the picture …"):
        demo_pushes.draw_pushes(picture, played, results, shown.words)
    if as_json:
        identity = {shown.words.machine: shown.felt.identity}
        summary = {**identity, **demo_pushes.metrics(results), "picture": str(picture)}
        print(json.dumps(summary, indent=2))
    else:
        console.print(demo_pushes.results_table(results, shown.words))
        console.print(demo_pushes.coverage_line(results))
        console.print(f"picture: {picture}", soft_wrap=True)
    if silent := sum(not result.sample_count for result in results):
        raise DemoError(
            f"no estimate came during {silent} of {len(results)} pushes; logs are in {options.out}"
        )


def _played(
    options: DemoOptions, script: Sequence[ScriptedPush], live: LiveMachine, console: Console
) -> PushRecord:
    from cablesense_ros.demo_pushes import play_script
    from cablesense_ros.machine_client import MachineClient, command_readers
    from cablesense_ros.node_process import node_in_thread

    words = live.shown.words

    def estimated() -> bool:
        return live.snapshot(time.monotonic()).answered

    with _nodes(options, live=False) as processes, node_in_thread("demo") as node:
        readers = command_readers(live.shown, "estimator", commissioner=options.commission)
        client = MachineClient(node, live, "estimator", readers)
        with status(f"Starting the simulated {words.machine} and the estimator …"):
            wait = partial(processes.wait_until, within_s=_START_S)
            wait(lambda: client.connected, otherwise="simulator and estimator did not come up")
            client.command(script[0].command)
            wait(estimated, otherwise="no estimate came")
            wait(lambda: live.reports_ok("tare"), otherwise="the estimator took no tare")
        by_tare = _known(live)
        console.print(f"After a tare, the {words.machine} is {by_tare}.")
        if options.commission:
            _commission(node, live, processes)
            taken = "the estimator did not take the calibration over"
            wait(lambda: _known(live) != by_tare, otherwise=taken)
            console.print(f"Commissioned, the {words.machine} is {_known(live)}.")
        with task_bars() as bars:
            show = bars.begin(f"pushing the {words.machine}")
            return play_script(client, live, script, processes.check, show)


def _known(live: LiveMachine) -> str:
    """How well the estimator says that it knows its machine."""
    return live.snapshot(time.monotonic()).machine_known or "not known"


def _commission(node: Node, live: LiveMachine, processes: Processes) -> None:
    """Let the arm be commissioned.

    Raises:
        CableSenseError: it does not begin, or stops before its end.
    """
    from std_srvs.srv import Trigger

    from cablesense_ros.endpoints import of_node

    client = node.create_client(Trigger, of_node("commissioner", topics.COMMISSION))
    wait = partial(processes.wait_until, within_s=_START_S)
    wait(client.service_is_ready, otherwise="the commissioner did not come up")

    def begun() -> bool:
        """Asked again while the last command is too recent."""
        future = client.call_async(Trigger.Request())
        wait(future.done, otherwise="the commissioner did not answer")
        answer = future.result()
        if answer is not None and answer.success:
            return True
        time.sleep(_ASK_EVERY_S)
        return False

    wait(begun, otherwise="the commissioning did not begin")
    with task_bars() as bars:
        show = bars.begin("commissioning")

        def ended() -> bool:
            progress = live.snapshot(time.monotonic()).commissioning
            if progress is not None:
                show(progress.done / max(progress.holds, 1))
            return live.commissioned is not None

        ending = "the commissioning did not end"
        processes.wait_until(ended, within_s=_COMMISSIONING_S, otherwise=ending)
    said = str(live.commissioned)
    if not said.startswith("done"):
        raise DemoError(f"the commissioning {said}")


def _checked(options: DemoOptions) -> tuple[DemoOptions, Loaded]:
    """Read arm and model before anything starts: a wrong file is one line, not a silent node."""
    from cablesense_online.loading import load

    loaded = load(options.arm, options.model)
    if options.breathe or not loaded.is_movable:
        options = replace(options, commission=False)
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CableSenseError(
            f"the folder {options.out} cannot be made ({error.strerror}); give another --out"
        ) from error
    return options, loaded


def node_commands(options: DemoOptions, live: bool) -> dict[str, list[str]]:
    """The command lines of all nodes but this process's own, by name; with the page if `live`."""
    arm: dict[str, object] = {"arm": options.arm}
    simulation = arm | {"seed": options.seed, "built_seed": options.built_seed}
    if is_machine_file(options.arm) or open_arm(options.arm).sensors.rate_hz < _LEAST_RATE_HZ:
        simulation["rate_hz"] = _LEAST_RATE_HZ
    if options.source is Source.SIM:
        commands = {"sim": node_command("sim", simulation)}
    else:
        amplifier = arm | {"map": _MAP, "channel": options.out.resolve() / "can_adapter"}
        adapter = {"interface": "slcan", "bitrate_bit_s": _BITRATE_BIT_S}
        remaps = {topics.CABLE_TENSIONS: topics.SIMULATED_TENSIONS}
        commands = {
            "can_emulator": node_command("can_emulator", amplifier),
            "can_driver": node_command(
                "can_driver", amplifier | adapter | {"joint_states": False}
            ),
            "sim": node_command("sim", simulation, remaps),
        }
    estimator = arm | {"model": options.model, "await_breath": options.breathe}
    commands["estimator"] = node_command("estimator", estimator)
    if options.breathe:
        breathing = {"over": topics.CABLE_OFFSETS, "continuous": True, "await_command": False}
        commands["breather"] = node_command("breather", arm | breathing | {"rest_s": _REST_S})
    if options.commission:
        visits = {"model": options.model, "poses": _POSES, "rest_s": _REST_S}
        commands["commissioner"] = node_command("commissioner", arm | visits)
    if live:
        at_start = {"home_at_start": True, "commission_at_start": options.commission}
        page = {"host": options.host, "port": options.port} | at_start
        commands["page"] = node_command("page", arm | page)
    return commands


def _nodes(options: DemoOptions, live: bool) -> Processes:
    return Processes(node_commands(options, live), options.out / "logs", own_graph())


def _open_in_browser(url: str) -> None:
    """Open the page where there is a screen: a text browser would take the terminal."""
    screens = (os.environ.get("DISPLAY"), os.environ.get("WAYLAND_DISPLAY"))
    if sys.platform != "linux" or any(screens):
        webbrowser.open(url)
