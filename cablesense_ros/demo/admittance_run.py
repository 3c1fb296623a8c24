"""The demo of a controller: a wall presses on the simulated arm, and the arm moves away."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from cablesense_msgs_py.errors import CableSenseError
from cablesense_ros.demo.nodes import demo_environment, node_command
from cablesense_ros.demo.processes import ChildCommand, Processes
from cablesense_sim.arm import Arm
from cablesense_sim.arm_files import open_arm
from cablesense_sim.mechanism import Mechanism

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
    commands = [*_commands(demo, PRESS_M, LIVE_DELAY_S), page]
    with Processes(commands, demo.out / "logs", demo_environment()) as processes:
        print("Starting the simulated arm, the estimator, the controller and the page …")
        url = processes.wait_for_line("page", "page: ", START_S)
        print(f"CableSense demo: open {url} in a browser; Ctrl-C ends it.", flush=True)
        processes.run_until_child_ends()


def run_controller_headless(demo: ControllerDemo, *, duration_s: float, as_json: bool) -> None:
    """Press for half of the time, leave for the other; print figures, draw a picture.

    Raises:
        CableSenseError: a file is wrong, a node died, or the controller never trusted the
            estimator.
    """
    arm = _checked_arm(demo)
    environment = demo_environment()
    os.environ.update(environment)  # before rclpy is imported: this process joins the same domain
    from cablesense_ros.admittance.arm_contact import compliance_m_n
    from cablesense_ros.admittance.elastic_wall import Approach
    from cablesense_ros.demo.admittance_observer import AdmittanceObserver, play_wall
    from cablesense_ros.demo.admittance_picture import draw_admittance
    from cablesense_ros.demo.admittance_record import figures

    mechanism = Mechanism.from_arm(arm)
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
                    lambda: observer.ready or None,
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
    from cablesense_training.inference.model_files import find_model
    from cablesense_training.inference.open_estimator import open_estimator

    arm = open_arm(demo.arm)
    open_estimator(find_model(demo.model or arm.name), arm)
    try:
        demo.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CableSenseError(
            f"the folder {demo.out} cannot be made ({error.strerror}); give another --out"
        ) from error
    return arm


def _commands(demo: ControllerDemo, depth_m: float, delay_s: float) -> list[ChildCommand]:
    wall: dict[str, str | int | float | bool] = {
        "arm": demo.arm,
        "segment": min(SEGMENT, open_arm(demo.arm).segment_count),
        "stiffness_n_m": STIFFNESS_N_M,
        "clearance_m": CLEARANCE_M,
        "speed_m_s": SPEED_M_S,
        "depth_m": depth_m,
        "delay_s": delay_s,
    }
    return [
        node_command("sim", {"arm": demo.arm, "seed": demo.seed}),
        node_command("estimator", {"arm": demo.arm, "model": demo.model}),
        node_command("admittance", {"arm": demo.arm, "deadband_n": DEADBAND_N}),
        node_command("obstacle", wall),
    ]
