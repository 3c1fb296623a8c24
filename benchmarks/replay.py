"""A run of simulator and estimator, recorded whole and replayed: are all estimates the same bits?

    python benchmarks/replay.py [--seconds 60] [--write]

Four processes as a user starts them: `sim` at 1,000 samples a second, `cablesense record`, the
estimator after it, and here an operator that pushes, commands, tares, undoes tares and changes a
parameter, at random times. The recording is replayed in process. An estimate is the same if every
byte of its wrench is: frame, force, torque and stamp.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections import Counter
from typing import Any

import harness
from harness import CABLESENSE
from live_run import ARM, LiveRun, Operator
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from cablesense_recording.mcap_messages import McapMessages
from cablesense_ros.processes import node_command

RATE_HZ = 1000.0
SEED = 20
LARGEST_ANGLE_RAD = 0.12
LEAST_N = 5.0
MOST_N = 60.0
ACTIONS = {"push": 0.45, "command": 0.3, "tare": 0.1, "tare_undo": 0.08, "parameter": 0.07}
"""How often each is chosen."""


class RandomOperator(Operator):
    """Random actions on the arm and on the estimator; `done` counts them."""

    def __init__(self) -> None:
        super().__init__("operator", SEED)
        self._triggers = {
            name: self.create_client(Trigger, f"/estimator/{name}")
            for name in ("tare", "tare_undo")
        }
        self._settings = self.create_client(SetParameters, "/estimator/set_parameters")
        self.done: Counter[str] = Counter()

    def connected(self) -> bool:
        """Whether sim, estimator and recorder are subscribed."""
        return self._commands.get_subscription_count() >= 3 and all(
            client.service_is_ready() for client in self._triggers.values()
        )

    def act(self) -> None:
        """One random action, then a random pause."""
        action = str(self.rng.choice(list(ACTIONS), p=list(ACTIONS.values())))
        match action:
            case "push":
                self.push(LEAST_N, MOST_N)
            case "command":
                self._move()
            case "parameter":
                threshold = Parameter("contact_threshold", value=float(self.rng.uniform(0.3, 0.9)))
                request = SetParameters.Request(parameters=[threshold.to_parameter_msg()])
                self.spin(10.0, self._settings.call_async(request))
            case _:
                future = self._triggers[action].call_async(Trigger.Request())
                self.spin(10.0, future)
                answer = future.result()
                action += "" if answer and answer.success else ", refused"
        self.done[action] += 1
        self.spin(float(self.rng.exponential(0.6)))

    def _move(self) -> None:
        reach_rad = LARGEST_ANGLE_RAD * self.rng.choice([0.05, 1.0])
        angles_rad = self.rng.uniform(-reach_rad, reach_rad, self.arm.joint_count)
        for _ in range(int(self.rng.integers(1, 4))):  # another comes while the arm moves
            self.command(angles_rad)
            self.spin(float(self.rng.exponential(0.1)))
            angles_rad = angles_rad * self.rng.uniform(0.5, 1.0)


def measure(seconds: float) -> dict[str, Any]:
    """Run, record and replay; the result with its bars."""
    with LiveRun() as run:
        file = run.folder / "whole.mcap"
        run.start("sim", node_command("sim", {"arm": ARM, "rate_hz": RATE_HZ}))
        recorder = run.start("recorder", [*CABLESENSE, "record", "--out", str(file)])
        operator = RandomOperator()
        operator.spin(3.0)  # the recorder is subscribed before the estimator publishes first
        run.start("estimator", node_command("estimator", {"arm": ARM, "tare_force": True}))
        operator.spin_until(operator.connected, "sim, estimator and recorder")
        operator.spin(2.0)
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            operator.act()
        recorder.stop()
        run.stop()
        operator.destroy_node()
        messages = Counter(message.topic for message in McapMessages(file))
        command = [*CABLESENSE, "replay", str(file), "--json"]
        replay = subprocess.run(command, capture_output=True, text=True, check=False)
    if not replay.stdout.startswith("{"):
        raise SystemExit(replay.stdout + replay.stderr)
    compared = json.loads(replay.stdout)
    same = replay.returncode == 0 and 0 < compared["compared"] == compared["identical"]
    return {
        "arm": ARM,
        "rate_hz": RATE_HZ,
        "seconds": seconds,
        "done to it": operator.done,
        "messages": messages,
        "in process": {"exit code": replay.returncode, **compared},
        "bars": {"all estimates bit-identical: in process": same},
    }


def main() -> int:
    """Measure and print; 1 where a bar is missed."""
    parser = harness.parser(__doc__, "results/replay.json")
    parser.add_argument("--seconds", type=float, default=60.0, help="of the run")
    given = parser.parse_args()
    return harness.publish("replay.json", measure(given.seconds), given, "rclpy")


if __name__ == "__main__":
    sys.exit(main())
