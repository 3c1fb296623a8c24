"""A run of simulator and estimator, recorded whole and replayed: are all estimates the same bits?

    python benchmarks/replay.py [--seconds 60] [--json] [--write]

Four processes as a user starts them: `sim` at 1,000 samples a second, `cablesense record`, the
estimator after it, and here an operator that pushes, commands, tares, undoes tares and changes a
parameter, at random times. In mid-run a second recorder joins, and is killed with SIGKILL.

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
from collections import Counter
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


class Operator:
    """Random actions on the arm and on the estimator; `done` counts them."""

    def __init__(self, arm_name: str) -> None:
        rclpy.init()
        self._arm = open_arm(arm_name)
        self._node = rclpy.create_node("operator")
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
        self.done: Counter[str] = Counter()

    def wait(self, listeners: int, estimator: Process) -> None:
        """Wait until sim, estimator and recorder are subscribed."""
        wait_until(
            lambda: (
                self._commands.get_subscription_count() >= listeners
                and all(client.service_is_ready() for client in self._services.values())
            ),
            30.0,
            "sim, estimator and recorder are not all subscribed",
            estimator.check,
        )

    def act(self) -> None:
        """One random action, then a random pause."""
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
            self._change_threshold()
        self.rest(float(self._rng.exponential(0.6)))

    def rest(self, seconds: float) -> None:
        """Spin for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.02)

    def close(self) -> None:
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
        self.done["loads"] += 1

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
            self.done["commands"] += 1
            self.rest(float(self._rng.exponential(0.1)))
            angles = angles * self._rng.uniform(0.5, 1.0)

    def _call(self, name: str) -> None:
        future = self._services[name].call_async(Trigger.Request())
        self._executor.spin_until_future_complete(future, timeout_sec=10.0)
        answer = future.result()
        if answer is not None:
            self.done[name if answer.success else f"{name}, refused"] += 1

    def _change_threshold(self) -> None:
        threshold = float(self._rng.uniform(0.3, 0.9))
        request = SetParameters.Request(
            parameters=[Parameter("contact_threshold", value=threshold).to_parameter_msg()]
        )
        self._executor.spin_until_future_complete(
            self._parameters.call_async(request), timeout_sec=10.0
        )
        self.done["parameters turned"] += 1


def measure(arm: str, seconds: float, folder: Path) -> dict[str, Any]:
    """Run, record and replay; the result with its origin and the bars."""
    whole, late = folder / "whole.mcap", folder / "late.mcap"
    sim = Process("sim", node_command("sim", {"arm": arm, "rate_hz": RATE_HZ}), folder / "sim.log")
    estimator_command = node_command("estimator", {"arm": arm})
    with sim, _recorder(whole) as recorder:
        operator = Operator(arm)
        time.sleep(3.0)  # the recorder is subscribed before the estimator publishes first
        with Process("estimator", estimator_command, folder / "estimator.log") as estimator:
            operator.wait(3, estimator)
            operator.rest(2.0)
            end = time.monotonic() + seconds
            joins, dies = end - (1 - LATE_JOINS_AT) * seconds, end - (1 - LATE_DIES_AT) * seconds
            began_s, began_cpu = time.monotonic(), harness.cpu_s(recorder.pid)
            second = None
            while time.monotonic() < end:
                operator.act()
                if second is None and time.monotonic() > joins:
                    second = _recorder(late)
                elif second is not None and second.alive and time.monotonic() > dies:
                    second.kill()
            share = (harness.cpu_s(recorder.pid) - began_cpu) / (time.monotonic() - began_s)
            recorder.stop()
        operator.close()
    result: dict[str, Any] = {
        **harness.origin("rclpy"),
        "arm": arm,
        "rate_hz": RATE_HZ,
        "seconds": seconds,
        "done to it": dict(operator.done),
        "recording": _recording(whole) | {"recorder, share of a core": round(share, 3)},
        "in process": _replay(whole),
        "begun in mid-run and killed, in process": _replay(late),
    }
    with Process("estimator", estimator_command, folder / "fresh.log") as fresh:
        result["through a live node"] = _replay(whole, "--publish")
        fresh.check()
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
    return result | {"bars": bars}


def _recorder(path: Path) -> Process:
    return Process(
        "recorder", [*harness.CABLESENSE, "record", "--out", str(path)], path.with_suffix(".log")
    )


def _recording(path: Path) -> dict[str, Any]:
    """Its content, and the samples without an answer between the first and the last."""
    counts = Counter(message.topic for message in McapMessages(path))
    answered = [step.answer is not None for step in RecordedRun(path).steps()]
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


def main() -> int:
    """Measure and print; 1 where a bar is missed."""
    parser = harness.parser(__doc__, "results/replay.json")
    parser.add_argument("--seconds", type=float, default=60.0, help="of the run")
    parser.add_argument("--arm", default="cdsm", help="bundled arm, or a path")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    given = parser.parse_args()
    os.environ.update(own_graph())
    with tempfile.TemporaryDirectory() as folder:
        result = measure(given.arm, given.seconds, Path(folder))
    if given.write:
        harness.write_result("replay.json", result)
    if given.json:
        print(json.dumps(result, indent=2))
    else:
        for name in ("recording", "done to it"):
            print(name, json.dumps(result[name]))
        for name, part in result.items():
            if isinstance(part, dict) and "identical" in part:
                print(f"{name}: {part['identical']} of {part['compared']} identical")
        harness.print_bars(result["bars"])
    return 0 if all(result["bars"].values()) else 1


if __name__ == "__main__":
    sys.exit(main())
