"""A run of simulator and estimator, recorded whole and replayed: are all estimates the same bits?

    python benchmarks/replay.py [--seconds 60] [--json] [--write]

Four processes as a user starts them: `sim` at 1,000 samples a second, `cablesense record`, the
estimator after it, and here a person who pushes, commands, tares, takes tares back and turns a
parameter, at times of chance. In mid-run a second recorder joins, and is killed with SIGKILL.

Both recordings are replayed in process, and the whole one once more through a fresh estimator
node. An estimate is the same if every byte of its wrench is: frame, force, torque (through a node
after the stamps' common shift is taken back).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import harness
import numpy as np
import rclpy
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.utilities import try_shutdown
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from cablesense_gap.recordings.mcap_messages import McapMessages
from cablesense_msgs_py import topics
from cablesense_msgs_py.qos import COMMAND
from cablesense_msgs_py.serialized import stamp_ns
from cablesense_online.recorded_run import RecordedRun
from cablesense_ros.discovery import own_graph
from cablesense_ros.node_process import qos_profile
from cablesense_ros.processes import Process, node_command, wait_until
from cablesense_sim.arm import open_arm

RATE_HZ = 1000.0
SEED = 20
LARGEST_ANGLE_RAD = 0.12
LARGEST_FORCE_N = 60.0
LATE_JOINS_AT, LATE_DIES_AT = 0.4, 0.7
"""Shares of the run."""


class Person:
    """Does things to the arm and to the estimator."""

    def __init__(self, arm_name: str) -> None:
        rclpy.init()
        self._arm = open_arm(arm_name)
        self._node = rclpy.create_node("person")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._rng = np.random.default_rng(SEED)
        self._commands = self._node.create_publisher(
            JointState, topics.JOINT_COMMANDS, qos_profile(COMMAND)
        )
        self._loads = self._node.create_publisher(
            WrenchStamped, topics.APPLIED_WRENCH, qos_profile(COMMAND)
        )
        self._services = {
            name: self._node.create_client(Trigger, f"/estimator/{name}")
            for name in ("tare", "tare_undo")
        }
        self._parameters = self._node.create_client(SetParameters, "/estimator/set_parameters")
        self._loaded = 0
        self.done: dict[str, int] = {}

    def wait(self, listeners: int, estimator: Process) -> None:
        """Until sim, estimator and recorder listen."""
        wait_until(
            lambda: (
                self._commands.get_subscription_count() >= listeners
                and all(client.service_is_ready() for client in self._services.values())
            ),
            30.0,
            "sim, estimator and recorder do not all listen",
            estimator.check,
        )

    def act(self) -> None:
        """One thing of chance, then some time until the next."""
        chance = self._rng.random()
        if chance < 0.45:
            self._push()
        elif chance < 0.75:
            self._command()
        elif chance < 0.85:
            self._call("tare")
        elif chance < 0.93:
            self._call("tare_undo")
        else:
            self._turn()
        self.rest(float(self._rng.exponential(0.6)))

    def rest(self, seconds: float) -> None:
        """Let time pass."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.02)

    def leave(self) -> None:
        """End."""
        self._executor.shutdown()
        self._node.destroy_node()
        try_shutdown()

    def _push(self) -> None:
        if self._loaded:
            self._load(self._loaded, np.zeros(3))
        self._loaded = int(self._rng.integers(1, self._arm.segment_count + 1))
        side = self._rng.normal(size=3)
        force = self._rng.uniform(5.0, LARGEST_FORCE_N) * side / np.linalg.norm(side)
        self._load(self._loaded, force)
        self._note("loads")

    def _load(self, segment: int, force_n: Any) -> None:
        message = WrenchStamped()
        message.header.frame_id = f"segment_{segment}"
        force = message.wrench.force
        force.x, force.y, force.z = map(float, force_n)
        self._loads.publish(message)

    def _command(self) -> None:
        reach = LARGEST_ANGLE_RAD * self._rng.choice([0.05, 1.0])
        angles = self._rng.uniform(-reach, reach, self._arm.joint_count)
        for _ in range(int(self._rng.integers(1, 4))):  # another comes while the arm moves
            self._commands.publish(
                JointState(name=list(self._arm.joint_names), position=angles.tolist())
            )
            self._note("commands")
            self.rest(float(self._rng.exponential(0.1)))
            angles = angles * self._rng.uniform(0.5, 1.0)

    def _call(self, name: str) -> None:
        future = self._services[name].call_async(Trigger.Request())
        self._executor.spin_until_future_complete(future, timeout_sec=10.0)
        answer = future.result()
        if answer is not None:
            self._note(name if answer.success else f"{name}, refused")

    def _turn(self) -> None:
        threshold = float(self._rng.uniform(0.3, 0.9))
        request = SetParameters.Request(
            parameters=[Parameter("contact_threshold", value=threshold).to_parameter_msg()]
        )
        self._executor.spin_until_future_complete(
            self._parameters.call_async(request), timeout_sec=10.0
        )
        self._note("parameters turned")

    def _note(self, what: str) -> None:
        self.done[what] = self.done.get(what, 0) + 1


def measure(arm: str, seconds: float, folder: Path) -> dict[str, Any]:
    """Run, record, replay; figures."""
    whole, late = folder / "whole.mcap", folder / "late.mcap"
    sim = Process("sim", node_command("sim", _sim(arm)), folder / "sim.log")
    estimator_command = node_command("estimator", {"arm": arm})
    with sim, _recorder(whole) as recorder:
        person = Person(arm)
        time.sleep(3.0)  # the recorder listens before the estimator says its first word
        with Process("estimator", estimator_command, folder / "estimator.log") as estimator:
            person.wait(3, estimator)
            person.rest(2.0)
            end = time.monotonic() + seconds
            joins, dies = end - (1 - LATE_JOINS_AT) * seconds, end - (1 - LATE_DIES_AT) * seconds
            began_s, began_cpu = time.monotonic(), harness.cpu_s(recorder.pid)
            second = None
            while time.monotonic() < end:
                person.act()
                if second is None and time.monotonic() > joins:
                    second = _recorder(late)
                elif second is not None and second.alive and time.monotonic() > dies:
                    second.kill()
            share = (harness.cpu_s(recorder.pid) - began_cpu) / (time.monotonic() - began_s)
            recorder.stop()
        person.leave()
    result = {
        "arm": arm,
        "rate_hz": RATE_HZ,
        "seconds": seconds,
        "done to it": person.done,
        "recording": _recording(whole) | {"recorder, share of a core": round(share, 3)},
        "in process": _replay(whole),
        "begun in mid-run and killed, in process": _replay(late),
    }
    with Process("estimator", estimator_command, folder / "fresh.log") as fresh:
        result["through a live node"] = _replay(whole, "--publish")
        fresh.check()
    return result


def _sim(arm: str) -> dict[str, Any]:
    return {"arm": arm, "rate_hz": RATE_HZ}


def _recorder(path: Path) -> Process:
    return Process(
        "recorder", [*harness.CABLESENSE, "record", "--out", str(path)], path.with_suffix(".log")
    )


def _recording(path: Path) -> dict[str, Any]:
    """What it holds, and whether samples lack between the first and the last answer."""
    counts: dict[str, int] = {}
    for message in McapMessages(path):
        counts[message.topic] = counts.get(message.topic, 0) + 1
    answered = [step.pair.answer is not None for step in RecordedRun(path).steps()]
    first, last = answered.index(True), len(answered) - answered[::-1].index(True)
    stamps = np.array(
        [stamp_ns(m.data) for m in McapMessages(path) if m.topic == "/cable_tensions"]
    )
    return {
        "megabytes": round(path.stat().st_size / 1e6, 1),
        "messages": dict(sorted(counts.items())),
        "samples without an answer between the first and the last": answered[first:last].count(
            False
        ),
        "median period of samples (ms)": round(float(np.median(np.diff(stamps))) * 1e-6, 3),
    }


def _replay(path: Path, *arguments: str) -> dict[str, Any]:
    done = subprocess.run(
        [*harness.CABLESENSE, "replay", str(path), "--json", *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    line = done.stdout.strip().splitlines()[-1] if done.stdout.strip() else done.stderr
    try:
        return {"exit code": done.returncode, **json.loads(line)}
    except ValueError as error:
        raise SystemExit(f"{path.name}: {done.stdout}{done.stderr}") from error


def report(result: dict[str, Any], seconds: float) -> dict[str, Any]:
    """The result with what made it and the bars."""
    replays = ("in process", "begun in mid-run and killed, in process", "through a live node")
    bars = {
        f"all estimates bit-identical: {name}": result[name]["exit code"] == 0
        and 0 < result[name]["compared"] == result[name]["identical"]
        for name in replays
    }
    bars["no contact without its sample in the recording"] = (
        result["in process"]["lone_contacts"] == 0
    )
    bars["the killed recording reads up to its last chunk"] = bool(
        result["begun in mid-run and killed, in process"]["cut"]
    )
    command = f"python benchmarks/replay.py --seconds {seconds:g} --write"
    return {**harness.origin(command, ["rclpy"]), **result, "bars": bars}


def main() -> int:
    """Measure and say."""
    parser = harness.parser(__doc__, "results/replay.json")
    parser.add_argument("--seconds", type=float, default=60.0, help="of the run")
    parser.add_argument("--arm", default="cdsm", help="bundled arm, or a path")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    given = parser.parse_args()
    os.environ.update(own_graph())
    with tempfile.TemporaryDirectory() as folder:
        result = report(measure(given.arm, given.seconds, Path(folder)), given.seconds)
    if given.write:
        harness.write_result("replay.json", result)
    if given.json:
        print(json.dumps(result, indent=2))
    else:
        for name in ("recording", "done to it"):
            print(name, json.dumps(result[name]))
        for name, figures in result.items():
            if isinstance(figures, dict) and "identical" in figures:
                print(f"{name}: {figures['identical']} of {figures['compared']} identical")
        for bar, kept in result["bars"].items():
            print(f"{'kept  ' if kept else 'MISSED'} {bar}")
    return 0 if all(result["bars"].values()) else 1


if __name__ == "__main__":
    sys.exit(main())
