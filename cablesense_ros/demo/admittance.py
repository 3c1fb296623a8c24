"""The demo of a controller: a wall presses on the simulated arm, and the arm moves away.

What a demo of the controller records, and the figures that it comes to.

The node of a headless demo of the controller: moves the wall, and writes down what happens.
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from cablesense_base.arrays import Array
from cablesense_base.errors import CableSenseError
from cablesense_msgs_py import qos, topics
from cablesense_msgs_py.joint_states import NamedOrder, joint_command_rad
from cablesense_msgs_py.topics import Frames
from cablesense_msgs_py.wrenches import read_load
from cablesense_online.admittance.estimate_watch import (
    EstimateWatch,
    Sight,
    WatchSettings,
    read_wrench,
)
from cablesense_online.admittance.wall import Approach
from cablesense_ros.discovery import own_graph, prefer_quick_discovery
from cablesense_ros.endpoints import of_node, qos_profile
from cablesense_ros.processes import Processes, node_command
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.build import mechanism_of

SEGMENT = 3
STIFFNESS_N_M = 10_000.0
CLEARANCE_M = 0.005
SPEED_M_S = 0.05
PRESS_M = 0.003
DEADBAND_N = 2.0
LIVE_DELAY_S = 15.0
START_S = 60.0


@dataclass(frozen=True)
class ControllerDemo:
    """What the command's options say.

    Attributes:
        arm, model: names or paths.
        host, port: where the page is served.
        out: folder of logs and picture.
        seed: of the sensors' noise.
    """

    arm: str
    model: str
    host: str
    port: int
    out: Path
    seed: int


def run_controller_live(demo: ControllerDemo) -> None:
    """Serve the page until Ctrl-C; the wall comes by itself and stays.

    Raises:
        CableSenseError: a file is wrong, or a node died or did not start.
    """
    _checked_arm(demo)
    page = node_command("page", {"arm": demo.arm, "host": demo.host, "port": demo.port})
    commands = _commands(demo, PRESS_M, LIVE_DELAY_S) | {"page": page}
    with Processes(commands, demo.out / "logs", own_graph()) as processes:
        print("Starting the simulated arm, the estimator, the controller and the page …")
        url = processes.wait_for_line("page", "page: ", START_S)
        print(f"CableSense demo: open {url} in a browser; Ctrl-C ends it.", flush=True)
        processes.run_until_one_ends()


def run_controller_headless(demo: ControllerDemo, *, duration_s: float, as_json: bool) -> None:
    """Press for half of the time, leave for the other; print figures, draw a picture.

    Raises:
        CableSenseError: a file is wrong, a node died, or the controller never trusted the
            estimator.
    """
    arm = _checked_arm(demo)
    environment = own_graph()
    os.environ.update(environment)  # before rclpy is imported: this process joins the same domain
    from cablesense_online.admittance.wall import Approach, compliance_m_n
    from cablesense_ros.demo.pictures import draw_admittance

    mechanism = mechanism_of(arm)
    segment = min(SEGMENT, arm.segment_count)
    aside = np.array([0.0, 1.0, 0.0])
    compliance = compliance_m_n(mechanism, np.zeros(arm.joint_count), segment, aside)
    console = Console(stderr=as_json)
    commands = _commands(demo, -CLEARANCE_M, 0.0)
    with Processes(commands, demo.out / "logs", environment) as processes:
        observer = AdmittanceObserver(arm)
        try:
            with console.status("Starting the simulated arm, the estimator and the controller …"):
                processes.wait_until(
                    lambda: observer.ready,
                    START_S,
                    f"the controller did not trust the estimator within {START_S:g} s",
                )
            with console.status(f"A wall presses on segment {segment} …"):
                record = play_wall(
                    observer,
                    PRESS_M,
                    -CLEARANCE_M,
                    Approach(-CLEARANCE_M, SPEED_M_S),
                    1.0 / (1.0 / STIFFNESS_N_M + compliance),
                    duration_s,
                    processes.check,
                )
        finally:
            observer.close()
    found = figures(record, DEADBAND_N)
    picture = demo.out / "admittance.png"
    draw_admittance(picture, record, segment, DEADBAND_N)
    if as_json:
        print(json.dumps({"arm": arm.identity, **found, "picture": str(picture)}, indent=2))
        return
    console.print(
        f"The wall would hold segment {segment} with {found['without_controller_n']:.1f} N. The "
        f"arm met {found['peak_n']:.1f} N and brought them down to {found['settled_n']:.1f} N in "
        f"{found['settling_s']:.1f} s and {found['steps']} steps."
    )
    console.print(f"picture: {picture}", soft_wrap=True)


def _checked_arm(demo: ControllerDemo) -> Arm:
    """Arm and model are read before anything starts: a wrong file is one line."""
    from cablesense_training.inference.metadata import find_model
    from cablesense_training.inference.temporal_estimator import open_estimator

    arm = open_arm(demo.arm)
    open_estimator(find_model(demo.model or arm.name), arm)
    try:
        demo.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CableSenseError(
            f"the folder {demo.out} cannot be made ({error.strerror}); give another --out"
        ) from error
    return arm


def _commands(demo: ControllerDemo, depth_m: float, delay_s: float) -> dict[str, list[str]]:
    wall: dict[str, object] = {
        "arm": demo.arm,
        "segment": min(SEGMENT, open_arm(demo.arm).segment_count),
        "stiffness_n_m": STIFFNESS_N_M,
        "clearance_m": CLEARANCE_M,
        "speed_m_s": SPEED_M_S,
        "depth_m": depth_m,
        "delay_s": delay_s,
    }
    parameters: dict[str, dict[str, object]] = {
        "sim": {"arm": demo.arm, "seed": demo.seed},
        "estimator": {"arm": demo.arm, "model": demo.model},
        "admittance": {"arm": demo.arm, "deadband_n": DEADBAND_N},
        "obstacle": wall,
    }
    return {name: node_command(name, given) for name, given in parameters.items()}


STEADY_S = 2.0
"""The end of the contact that the settled force is averaged over."""


@dataclass(frozen=True)
class AdmittanceRecord:
    """A course of K moments.

    Attributes:
        times_s: (K,) since the wall began to move.
        true_n: (K,) force of the wall on the arm.
        unyielding_n: (K,) what the wall would press with, had the arm not been commanded away.
        estimated_n: (K,) the estimator's.
        commands_rad: (K, 2N) commands in force.
        sights: (K,) what could be known of contacts.
        leaves_s: when the wall began to retreat.
    """

    times_s: Array
    true_n: Array
    unyielding_n: Array
    estimated_n: Array
    commands_rad: Array
    sights: tuple[Sight, ...]
    leaves_s: float


def figures(record: AdmittanceRecord, deadband_n: float) -> dict[str, Any]:
    """Forces without and with controller, N, and when the force came to rest, s."""
    pressed = record.times_s < record.leaves_s
    steady = pressed & (record.times_s >= record.leaves_s - STEADY_S)
    settled_n = float(record.true_n[steady].mean())
    touched = np.flatnonzero(pressed & (record.unyielding_n > deadband_n))
    above = np.flatnonzero(pressed & (record.true_n > settled_n + 1.0))
    settling_s = (
        float(record.times_s[above[-1]] - record.times_s[touched[0]])
        if len(above) and len(touched)
        else 0.0
    )
    changed = np.abs(np.diff(record.commands_rad, axis=0)).max(axis=1) > 0.0
    return {
        "without_controller_n": float(record.unyielding_n[steady].mean()),
        "peak_n": float(record.true_n[pressed].max()),
        "settled_n": settled_n,
        "settling_s": settling_s,
        "steps": int(np.count_nonzero(changed & pressed[1:])),
        "left_from_home_deg": float(np.rad2deg(np.abs(record.commands_rad[-1]).max())),
    }


RECORD_EVERY_S = 0.04
PRESS_AT_S = 1.0
_STATUS = "admittance: control"


class AdmittanceObserver:
    """Listens in a thread of its own until `close`."""

    def __init__(self, arm: Arm) -> None:
        prefer_quick_discovery()
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("demo")
        self._frames = Frames(arm.segment_count)
        self._joints = NamedOrder(arm.joint_names, "joints")
        self._lock = threading.Lock()
        self._command = np.zeros(arm.joint_count)
        self._watch = EstimateWatch(
            self._command, WatchSettings(resume_after_s=0.0), time.monotonic()
        )
        self._true_n = self._estimated_n = 0.0
        self._control = ""
        for kind, topic, handle in (
            (WrenchStamped, topics.APPLIED_WRENCH, self._on_load),
            (JointState, topics.JOINT_COMMANDS, self._on_command),
            (WrenchStamped, of_node("estimator", topics.WRENCH), self._on_wrench),
            (
                Float64MultiArray,
                of_node("estimator", topics.CONTACT_PROBABILITIES),
                self._on_probabilities,
            ),
            (DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics),
        ):
            self._node.create_subscription(kind, topic, handle, qos_profile(qos.COMMAND))
        self._wall = self._node.create_client(SetParameters, "obstacle/set_parameters")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, name="demo observer", daemon=True)
        self._thread.start()

    @property
    def ready(self) -> bool:
        """Whether the wall can be moved and the controller trusts the estimator."""
        return self._wall.service_is_ready() and self._control in ("free", "contact", "blind")

    def move_wall(self, depth_m: float) -> None:
        """Set where the wall stops."""
        value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=depth_m)
        request = SetParameters.Request(parameters=[Parameter(name="depth_m", value=value)])
        self._wall.call_async(request)

    def close(self) -> None:
        """End the node and its thread."""
        self._executor.shutdown()
        self._thread.join(timeout=2.0)
        self._node.destroy_node()
        rclpy.try_shutdown()

    def moment(self) -> tuple[Any, ...]:
        """True and estimated force, command and sight, now."""
        with self._lock:
            sight = self._watch.look(time.monotonic())
            return self._true_n, self._estimated_n, self._command, sight

    def _on_load(self, message: WrenchStamped) -> None:
        with suppress(CableSenseError):
            self._true_n = float(np.linalg.norm(read_load(message, self._frames).force_base_n))

    def _on_command(self, message: JointState) -> None:
        with suppress(CableSenseError), self._lock:
            self._command = joint_command_rad(message, self._joints)
            self._watch.commanded(self._command, time.monotonic())

    def _on_wrench(self, message: WrenchStamped) -> None:
        with suppress(CableSenseError), self._lock:
            felt = read_wrench(message, self._frames)
            self._estimated_n = float(np.linalg.norm(felt.force_n))
            self._watch.heard_wrench(bool(felt.segment), 0.0, time.monotonic())

    def _on_probabilities(self, _: Float64MultiArray) -> None:
        with self._lock:
            self._watch.heard_probabilities(time.monotonic())

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == _STATUS:
                self._control = status.message.partition(";")[0]

    def _spin(self) -> None:
        with suppress(ExternalShutdownException):
            self._executor.spin()


def play_wall(
    observer: AdmittanceObserver,
    press_m: float,
    leave_m: float,
    approach: Approach,
    unyielding_stiffness_n_m: float,
    duration_s: float,
    check: Callable[[], None],
) -> AdmittanceRecord:
    """Press for half of the time, then leave; the record in real time.

    Args:
        observer: moves the wall and watches.
        press_m: where the wall stops, along its normal, to press.
        leave_m: where it stops to leave.
        approach: as the obstacle's, to know where the wall is.
        unyielding_stiffness_n_m: wall and arm in series.
        duration_s: of the whole.
        check: called at every step; raises to end the play.
    """
    leaves_s = 0.5 * duration_s
    target_m, before_s = leave_m, 0.0
    start = time.monotonic()
    rows = []
    while (now_s := time.monotonic() - start) < duration_s:
        check()
        wanted_m = press_m if PRESS_AT_S <= now_s < leaves_s else leave_m
        if wanted_m != target_m:
            target_m = wanted_m
            observer.move_wall(target_m)
        advance_m = approach.towards(target_m, now_s - before_s)
        before_s = now_s
        unyielding_n = max(0.0, unyielding_stiffness_n_m * advance_m)
        rows.append((now_s, unyielding_n, *observer.moment()))
        time.sleep(RECORD_EVERY_S)
    times, unyielding, true, estimated, commands, sights = zip(*rows, strict=True)
    return AdmittanceRecord(
        times_s=np.array(times),
        true_n=np.array(true),
        unyielding_n=np.array(unyielding),
        estimated_n=np.array(estimated),
        commands_rad=np.array(commands),
        sights=tuple(sights),
        leaves_s=leaves_s,
    )
