"""A run of simulator and estimator, recorded whole and replayed: are all estimates the same bits?

    python benchmarks/replay.py [--seconds 60] [--write]

Four processes as a user starts them: `sim` at 1,000 samples a second, `cablesense record`, the
estimator after it, and here an operator that pushes, commands, tares, undoes tares and changes a
parameter, at random times. In mid-run a second recorder joins, and is killed with SIGKILL.

Both recordings are replayed in process. An estimate is the same if every byte of its wrench is:
frame, force, torque and stamp.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import harness
import numpy as np
from geometry_msgs.msg import WrenchStamped
from live_run import LiveRun, SpunNode, load_message
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from cablesense_gap.recordings.mcap_messages import McapMessages
from cablesense_msgs_py import topics
from cablesense_msgs_py.qos import COMMAND
from cablesense_ros.endpoints import qos_profile
from cablesense_ros.processes import node_command
from cablesense_sim.arm import Arm, open_arm

ARM, RATE_HZ = "cdsm", 1000.0
SEED = 20
LARGEST_ANGLE_RAD = 0.12
LARGEST_FORCE_N = 60.0
LATE_JOINS_AT, LATE_DIES_AT = 0.4, 0.7
"""Shares of the run."""


class Operator(SpunNode):
    """Random actions on the arm and on the estimator; `done` counts them."""

    def __init__(self, arm: Arm) -> None:
        super().__init__("operator")
        self._arm = arm
        self._rng = np.random.default_rng(SEED)
        qos = qos_profile(COMMAND)
        self._commands = self.create_publisher(JointState, topics.JOINT_COMMANDS, qos)
        self._loads = self.create_publisher(WrenchStamped, topics.APPLIED_WRENCH, qos)
        self._triggers = {
            name: self.create_client(Trigger, f"/estimator/{name}")
            for name in ("tare", "tare_undo")
        }
        self._settings = self.create_client(SetParameters, "/estimator/set_parameters")
        self._loaded = 0
        self.done: Counter[str] = Counter()

    def connected(self) -> bool:
        """Whether sim, estimator and recorder are subscribed."""
        return self._commands.get_subscription_count() >= 3 and all(
            client.service_is_ready() for client in self._triggers.values()
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
            threshold = Parameter("contact_threshold", value=float(self._rng.uniform(0.3, 0.9)))
            request = SetParameters.Request(parameters=[threshold.to_parameter_msg()])
            self.spin(10.0, self._settings.call_async(request))
            self.done["parameters turned"] += 1
        self.spin(float(self._rng.exponential(0.6)))

    def _push(self) -> None:
        if self._loaded:
            self._loads.publish(load_message(self._loaded, np.zeros(3)))
        self._loaded = int(self._rng.integers(1, self._arm.segment_count + 1))
        side = self._rng.normal(size=3)
        force_n = self._rng.uniform(5.0, LARGEST_FORCE_N) * side / np.linalg.norm(side)
        self._loads.publish(load_message(self._loaded, force_n))
        self.done["loads"] += 1

    def _command(self) -> None:
        reach = LARGEST_ANGLE_RAD * self._rng.choice([0.05, 1.0])
        angles = self._rng.uniform(-reach, reach, self._arm.joint_count)
        for _ in range(int(self._rng.integers(1, 4))):  # another comes while the arm moves
            names = list(self._arm.joint_names)
            self._commands.publish(JointState(name=names, position=angles.tolist()))
            self.done["commands"] += 1
            self.spin(float(self._rng.exponential(0.1)))
            angles = angles * self._rng.uniform(0.5, 1.0)

    def _call(self, name: str) -> None:
        future = self._triggers[name].call_async(Trigger.Request())
        self.spin(10.0, future)
        if (answer := future.result()) is not None:
            self.done[name if answer.success else f"{name}, refused"] += 1


def measure(seconds: float) -> dict[str, Any]:
    """Run, record and replay; the result with its origin and the bars."""
    killed = "begun in mid-run and killed, in process"
    estimator_command = node_command("estimator", {"arm": ARM, "tare_force": True})
    with LiveRun() as run:
        run.start("sim", node_command("sim", {"arm": ARM, "rate_hz": RATE_HZ}))
        recorder = run.record("whole")
        operator = Operator(open_arm(ARM))
        operator.spin(3.0)  # the recorder is subscribed before the estimator publishes first
        run.start("estimator", estimator_command)
        operator.spin_until(operator.connected, "sim, estimator and recorder")
        operator.spin(2.0)
        began_s = time.monotonic()
        late_file, late, share = run.folder / "late.mcap", None, 0.0
        while late is None or late.alive or share < 1.0:
            operator.act()
            share = (time.monotonic() - began_s) / seconds
            if late is None and share > LATE_JOINS_AT:
                late = run.record("late")
            elif late and late.alive and share > LATE_DIES_AT and late_file.exists():
                late.kill()
        recorder.stop()
        run.stop()
        operator.destroy_node()
        whole = run.folder / "whole.mcap"
        result: dict[str, Any] = {
            "arm": ARM,
            "rate_hz": RATE_HZ,
            "seconds": seconds,
            "done to it": dict(operator.done),
            "messages": dict(Counter(message.topic for message in McapMessages(whole))),
            "in process": _replay(whole),
            killed: _replay(late_file),
        }
    bars = {
        f"all estimates bit-identical: {name}": result[name]["exit code"] == 0
        and 0 < result[name]["compared"] == result[name]["identical"]
        for name in ("in process", killed)
    }
    bars["no contact without its sample in the recording"] = (
        result["in process"]["lone_contacts"] == 0
    )
    bars["the killed recording reads up to its last chunk"] = bool(result[killed]["cut"])
    return result | {"bars": bars}


def _replay(path: Path) -> dict[str, Any]:
    done = subprocess.run(
        [*harness.CABLESENSE, "replay", str(path), "--json"],
        capture_output=True,
        text=True,
        check=False,
    )
    try:
        return {"exit code": done.returncode, **json.loads(done.stdout)}
    except ValueError as error:
        raise SystemExit(f"{path.name}: {done.stdout}{done.stderr}") from error


def main() -> int:
    """Measure and print; 1 where a bar is missed."""
    parser = harness.parser(__doc__, "results/replay.json")
    parser.add_argument("--seconds", type=float, default=60.0, help="of the run")
    given = parser.parse_args()
    return harness.publish("replay.json", measure(given.seconds), given, "rclpy")


if __name__ == "__main__":
    sys.exit(main())
