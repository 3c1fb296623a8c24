"""A wall presses on the simulated arm, and the arm moves away.

    python -m examples.admittance [--duration 24] [--page] [--json]

Starts the simulated arm, the estimator and the controller. The wall is in this process: it presses
for half of the time and then leaves. With `--page` the arm is shown in the browser.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState

from cablesense_base import Array, CableSenseError
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import NamedOrder, joint_command_rad
from cablesense_msgs_py.qos import COMMAND
from cablesense_ros.endpoints import RefusalLog
from cablesense_ros.node_process import node_in_thread
from cablesense_ros.processes import Processes, node_command, own_graph
from cablesense_sim.arm import open_arm
from examples.admittance.wall import Obstacle

ARM = "cdsm"
SEGMENT = 3
STIFFNESS_N_M = 10_000.0
# where the wall presses, and where it is clear of the arm
PRESS_M = 0.003
CLEAR_M = -0.005
PRESS_AT_S = 1.0
STEADY_S = 2.0  # the settled force is averaged over the end of the contact
START_S = 60.0
EVERY_S = 0.04


def play(duration_s: float, logs: Path, page: bool = False) -> dict[str, Any]:
    """Press and leave in real time; the forces without and with the controller, N.

    Raises:
        CableSenseError: a node ended, or the controller did not trust the estimator.
    """
    arm = open_arm(ARM)
    parameters = {"arm": ARM}
    commands = {name: node_command(name, parameters) for name in ("sim", "estimator")}
    commands["admittance"] = node_command("examples.admittance.controller_node", parameters)
    if page:
        commands["page"] = node_command("page", parameters)
    os.environ.update(own_graph())
    joints = NamedOrder(arm.joint_names, "joints")
    present_rad = np.zeros(arm.joint_count)

    def on_command(message: JointState) -> None:
        nonlocal present_rad
        present_rad = joint_command_rad(message, joints, present_rad)

    with Processes(commands, logs, own_graph()) as processes, node_in_thread("wall") as node:
        RefusalLog(node).subscribe(JointState, topics.JOINT_COMMANDS, COMMAND, on_command)
        obstacle = Obstacle(node, arm, SEGMENT, STIFFNESS_N_M, CLEAR_M)
        if page:
            print("open", processes.wait_for_line("page", "page: ", START_S), file=sys.stderr)
        trusted = "the controller did not trust the estimator"
        processes.wait_until(
            lambda: "estimates are trusted" in processes["admittance"].log, START_S, trusted
        )
        start_s = time.monotonic()
        moments = []
        leaves_s = 0.5 * duration_s
        while (now_s := time.monotonic() - start_s) < duration_s:
            processes.check()
            obstacle.target_m = PRESS_M if PRESS_AT_S <= now_s < leaves_s else CLEAR_M
            moments.append((now_s, obstacle.advance_m, obstacle.wall.force_n, present_rad))
            time.sleep(EVERY_S)
    times_s, advances_m, forces_n, commands_rad = map(np.array, zip(*moments, strict=True))
    yielding_m_n = 1.0 / STIFFNESS_N_M + obstacle.wall.compliance_m_n  # springs in series
    unyielding_n = np.maximum(0.0, advances_m) / yielding_m_n
    return metrics(times_s, forces_n, unyielding_n, commands_rad, leaves_s)


def metrics(
    times_s: Array, forces_n: Array, unyielding_n: Array, commands_rad: Array, leaves_s: float
) -> dict[str, Any]:
    """Forces (K,) without and with the controller, N, and when the force had settled, s."""
    pressed = times_s < leaves_s
    steady = pressed & (times_s >= leaves_s - STEADY_S)
    settled_n = float(forces_n[steady].mean())
    touched = np.flatnonzero(pressed & (unyielding_n > 0.0))
    above = np.flatnonzero(pressed & (forces_n > settled_n + 1.0))
    settling_s = times_s[above[-1]] - times_s[touched[0]] if len(above) and len(touched) else 0.0
    changed = np.abs(np.diff(commands_rad, axis=0)).max(axis=1) > 0.0
    return {
        "without_controller_n": float(unyielding_n[steady].mean()),
        "peak_n": float(forces_n[pressed].max()),
        "settled_n": settled_n,
        "settling_s": float(settling_s),
        "steps": int(np.count_nonzero(changed & pressed[1:])),
        "left_from_home_deg": float(np.rad2deg(np.abs(commands_rad[-1]).max())),
    }


def main() -> int:
    """Play and print."""
    parser = argparse.ArgumentParser(prog="python -m examples.admittance", description=__doc__)
    parser.add_argument("--duration", type=float, default=24.0, help="seconds")
    parser.add_argument("--page", action="store_true", help="show the arm in the browser")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--logs", type=Path, default=Path("out/admittance"), help="of the nodes")
    options = parser.parse_args()
    try:
        figures = play(options.duration, options.logs, options.page)
    except CableSenseError as error:
        print(error, file=sys.stderr)
        return 1
    if options.json:
        print(json.dumps(figures, indent=2))
        return 0
    print(
        f"The wall would hold segment {SEGMENT} with {figures['without_controller_n']:.1f} N. The "
        f"arm met {figures['peak_n']:.1f} N and reduced them to {figures['settled_n']:.1f} N in "
        f"{figures['settling_s']:.1f} s and {figures['steps']} steps."
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
