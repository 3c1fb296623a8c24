"""A demo of a machine that MuJoCo describes: simulated, pushed link by link, and estimated."""

from __future__ import annotations

import json
import os
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table

from cablesense_base import Array
from cablesense_msgs_py import topics
from cablesense_ros.processes import Processes, node_command, own_graph
from cablesense_sim.machine.machine import Machine, open_machine
from cablesense_sim.machine.statics import MachineStatics

if TYPE_CHECKING:
    from collections.abc import Callable

    from geometry_msgs.msg import WrenchStamped

_START_S = 120.0
"""Slow machines import and compile for a minute the first time."""
_SETTLED_S = 1.0
"""From a push to the estimate that is shown."""
_SHARES = (0.15, 0.4)
"""Pushes, as shares of the largest force that the machine file expects."""
_STATE_S = 10.0
"""How long a state of the estimator is waited for."""


@dataclass(frozen=True)
class MachinePush:
    """A push in the middle of a link, and what was estimated.

    Attributes:
        link: pushed.
        size_n: of the push.
        state: that the estimator states.
        estimated_link: the frame of the estimated force; empty without one.
        estimated_n: its size; None where it is not known.
        low_n, high_n: its 95 % interval.
        off_mm: distance of the stated place from the true one; None on another link.
    """

    link: str
    size_n: float
    state: str
    estimated_link: str = ""
    estimated_n: float | None = None
    low_n: float | None = None
    high_n: float | None = None
    off_mm: float | None = None


def run_machine_demo(
    file: str, model: str, out: Path, seed: int, built_seed: int, *, as_json: bool
) -> None:
    """Push every link of a simulated machine; print a table, draw a picture.

    Raises:
        CableSenseError: a file is wrong, a node ended, or no estimates came.
    """
    from cablesense_online.machine_models import load_machine

    machine = open_machine(file)
    load_machine(file, model)
    out.mkdir(parents=True, exist_ok=True)
    os.environ.update(own_graph())  # before rclpy starts: this process joins the same domain
    console = Console(stderr=as_json)
    simulation = {"machine": file, "seed": seed, "built_seed": built_seed}
    commands = {
        "machine_sim": node_command("machine_sim", simulation),
        "estimator": node_command("estimator", {"arm": file, "model": model}),
    }
    with Processes(commands, out / "logs", own_graph()) as processes:
        pushes = _pushed(machine, processes, console)
    picture = out / "demo.png"
    _draw(picture, machine, pushes)
    if as_json:
        content = {"machine": machine.identity, "pushes": [asdict(push) for push in pushes]}
        print(json.dumps({**content, "picture": str(picture)}, indent=2))
        return
    console.print(_table(pushes))
    known = [push for push in pushes if push.state == "contact"]
    right = sum(push.link == push.estimated_link for push in pushes)
    held = sum((push.low_n or 0.0) <= push.size_n <= (push.high_n or 0.0) for push in known)
    console.print(f"right link: {right} of {len(pushes)}")
    console.print(f"true force within the stated 95 % interval: {held} of {len(known)}")
    console.print(f"picture: {picture}", soft_wrap=True)


def _pushed(machine: Machine, processes: Processes, console: Console) -> list[MachinePush]:
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import PointStamped, WrenchStamped
    from rich.progress import track

    from cablesense_msgs_py.messages import ForceState, read_force_state
    from cablesense_ros.endpoints import of_node
    from cablesense_ros.node_process import node_in_thread

    latest: dict[str, Any] = {}
    with node_in_thread("demo") as node:

        def keep(topic: str) -> Callable[[Any], None]:
            return lambda message: latest.update({topic: message})

        for kind, topic in (
            (WrenchStamped, topics.WRENCH),
            (WrenchStamped, topics.WRENCH_LOWER),
            (WrenchStamped, topics.WRENCH_UPPER),
            (PointStamped, topics.CONTACT_POINT),
            (DiagnosticArray, topics.STATUS),
        ):
            node.create_subscription(kind, of_node("estimator", topic), keep(topic), 10)
        loads = node.create_publisher(WrenchStamped, topics.APPLIED_WRENCH, 10)

        def state() -> ForceState | None:
            status = latest.get(topics.STATUS)
            return None if status is None else read_force_state(status)[0]

        def free() -> bool:
            return state() is ForceState.FREE

        with console.status("Starting the simulated machine and the estimator …"):
            processes.wait_until(free, _START_S, "no estimate of the untouched machine came")
        pushes = []
        wanted = [(n, share) for share in _SHARES for n in range(len(machine.links.names))]
        largest_n = machine.source.file.touch.largest_n
        for n, share in track(wanted, "pushing", console=console, transient=True):
            message = _push(machine, n, share * largest_n)
            loads.publish(message)
            time.sleep(_SETTLED_S)
            processes.check()
            pushes.append(_result(machine, n, share * largest_n, state(), latest))
            loads.publish(_push(machine, n, 0.0))
            processes.wait_until(free, _STATE_S, "the machine did not become free again")
        return pushes


def _push(machine: Machine, link: int, size_n: float) -> WrenchStamped:
    """A push across a link, in base axes as loads are."""
    from geometry_msgs.msg import WrenchStamped

    statics = MachineStatics(machine)
    statics.at(machine.reference)
    across = statics.links().axes[link] @ np.array([0.0, 0.6, 0.8])
    message = WrenchStamped()
    message.header.frame_id = machine.links.names[link]
    force = message.wrench.force
    force.x, force.y, force.z = (size_n * across).tolist()
    return message


def _result(
    machine: Machine, link: int, size_n: float, state: Any, latest: dict[str, Any]
) -> MachinePush:
    name = machine.links.names[link]
    wrench = latest[topics.WRENCH]
    stated = "none" if state is None else state.value
    estimated = wrench.header.frame_id if _size_n(wrench) > 0.0 or _has_place(state) else ""
    if estimated not in machine.links.names:
        return MachinePush(name, size_n, stated)
    lower = latest.get(topics.WRENCH_LOWER)
    upper = latest.get(topics.WRENCH_UPPER)
    off_mm = None
    point = latest.get(topics.CONTACT_POINT)
    if estimated == name and point is not None and point.header.frame_id == name:
        off_mm = 1e3 * float(np.linalg.norm(_place(point) - _middle(machine, link)))
    return MachinePush(
        link=name,
        size_n=size_n,
        state=stated,
        estimated_link=estimated,
        estimated_n=_size_n(wrench) or None,
        low_n=None if lower is None else _size_n(lower),
        high_n=None if upper is None else _size_n(upper),
        off_mm=off_mm,
    )


def _has_place(state: Any) -> bool:
    """Whether a contact is stated, be its force known or not."""
    return state is not None and state.value in ("contact", "moment", "unconfirmed")


def _size_n(wrench: WrenchStamped) -> float:
    force = wrench.wrench.force
    return float(np.linalg.norm([force.x, force.y, force.z]))


def _place(point: Any) -> Array:
    return np.array([point.point.x, point.point.y, point.point.z])


def _middle(machine: Machine, link: int) -> Array:
    """(3,) of where a link is touched, in the frame of its body."""
    links = machine.links
    middle_m = float(links.touched_m[link].mean())
    return np.asarray(links.origin_m[link] + middle_m * links.axes[link, :, 0])


def _table(pushes: list[MachinePush]) -> Table:
    table = Table(title="Pushes in the middle of each link")
    for head in (
        "link",
        "true N",
        "state",
        "on",
        "estimated N",
        "95 % interval N",
        "place off mm",
    ):
        table.add_column(head)
    for push in pushes:
        known = push.state == "contact" and push.estimated_n is not None
        table.add_row(
            push.link,
            f"{push.size_n:.2f}",
            push.state,
            push.estimated_link or "–",
            f"{push.estimated_n:.2f}" if known else "–",
            f"{push.low_n:.2f} … {push.high_n:.2f}" if known else "–",
            "–" if push.off_mm is None or not known else f"{push.off_mm:.1f}",
        )
    return table


def _draw(path: Path, machine: Machine, pushes: list[MachinePush]) -> None:
    """The links in the reference pose; by push, the stated force over the true one."""
    import matplotlib.pyplot as plt

    statics = MachineStatics(machine)
    statics.at(machine.reference)
    frames = statics.links()
    figure = plt.figure(figsize=(10.0, 4.5), layout="constrained")
    scene = figure.add_subplot(1, 2, 1, projection="3d")
    for n, name in enumerate(machine.links.names):
        ends = [
            frames.origin_m[n] + place_m * frames.axes[n, :, 0]
            for place_m in machine.links.touched_m[n]
        ]
        x, y, z = np.array(ends).T
        scene.plot(x, y, z, linewidth=4)
        scene.text(*np.mean(ends, axis=0), name, fontsize=7)
    scene.set_title(machine.name)
    scene.set_aspect("equal", adjustable="datalim")
    chart = figure.add_subplot(1, 2, 2)
    known = [push for push in pushes if push.state == "contact" and push.estimated_n is not None]
    for number, push in enumerate(known):
        chart.vlines(number, push.low_n or 0.0, push.high_n or 0.0, colors="#e8590c", linewidth=3)
        chart.plot(number, push.size_n, "k_", markersize=14)
    chart.set_xticks(range(len(known)), [push.link for push in known], rotation=60, fontsize=7)
    chart.set_ylabel("force, N")
    chart.set_title("true (black) and stated 95 % interval")
    figure.savefig(path, dpi=130)
    plt.close(figure)
