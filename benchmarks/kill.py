"""Kill −9: driver, sim and estimator killed under load again and again, seen from outside.

    python benchmarks/kill.py [--times 50] [--write]

The sim, amplifiers as CAN frames over slcan on a pseudo-terminal, `can_driver` and `estimator` run
as processes while the load on the arm changes. The estimator has a calibration file, of unloaded
poses, and begins with it again. Each victim in turn is killed at a random moment (in half of the
kills the load changes while it is dead), started again, and watched from here: do the others
continue, how soon is the wrench reported as stale, how soon is it right again, is any false force
published.

When driver or sim are dead, stale is a zero wrench with a fresh stamp. When the estimator itself
is dead nothing is published on its topic; the subscriber's own middleware reports it, by the
liveliness that the estimator offers on `~/wrench`. Right is a wrench on the right segment, ten
times in a row: a moment about the joint within that of 2 N or 3 % of the load, and a force within
as much where one is stated; on segment 1 it is not.

    python benchmarks/kill.py --lifecycle 200 [--write]

An estimator of the sim's samples is configured, activated, deactivated and cleaned up that often.
It must answer each time, while this process subscribes to its wrenches and unsubscribes some
hundred times a second.
"""

from __future__ import annotations

import itertools
import re
import sys
import time
from collections import deque
from collections.abc import Mapping
from math import nan
from pathlib import Path
from typing import Any, NamedTuple

import harness
import numpy as np
import pandas as pd
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from live_run import ARM, LiveRun, Operator, SpunNode, Usage, memory_bars
from rclpy.event_handler import QoSLivelinessChangedInfo, SubscriptionEventCallbacks
from rclpy.subscription import Subscription

from cablesense_base import Array
from cablesense_contact.calibration import Calibrator, Unloaded
from cablesense_contact.calibration_file import write_calibration
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.inference.law_model import LawModel
from cablesense_contact.inference.metadata import find_model_of
from cablesense_msgs_py.qos import Qos
from cablesense_ros.endpoints import qos_profile
from cablesense_ros.processes import Process, node_command
from cablesense_sim.arm import of_each_segment, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.replay import read_tensions_n

STALE_WITHIN_S = 0.1
RIGHT_WITHIN_S = 1.0
RATE_HZ = 200.0
STALE_AFTER_S = 0.05
LEASE_S = 0.08
"""After so long without a sign of life of the estimator, the middleware reports it as gone."""

CALIBRATED_POSES = 25
CALIBRATED_BEND_RAD = float(np.deg2rad(10.0))
POSE_READINGS = 50

LOAD_EVERY_S = 0.05
COMMAND_EVERY_S = 0.5
LEAST_N = 20.0
MOST_N = 100.0
TOLERANCE_N = 2.0
TOLERANCE = 0.03
"""A wrench is right when it is no further from the load than the larger of these."""

STEADY = 10
"""The number of right wrenches in a row that counts as right."""

SETTLED_S = 1.0
"""A change of load has swung out by then; a wrench that differs from the load later is wrong."""

SWING_S = 0.2
DEAD_S = (0.15, 0.6)
AT_ANY_MOMENT_S = 0.5

_SET_UP = {
    "driver": r"\[INFO\] \[([\d.]+)\] \[can_driver\]: arm ",
    "sim": r"\[INFO\] \[([\d.]+)\] \[sim\]: .* channels at ",
    "estimator": r"\[INFO\] \[([\d.]+)\] \[estimator\]: arm .*: configured",
}

LOOP = (
    Transition.TRANSITION_CONFIGURE,
    Transition.TRANSITION_ACTIVATE,
    Transition.TRANSITION_DEACTIVATE,
    Transition.TRANSITION_CLEANUP,
)
SUBSCRIBED_EVERY_S = 0.003
SUBSCRIPTIONS = 3


def start_chain(run: LiveRun) -> None:
    """Start sim, amplifiers, driver and estimator."""
    link = run.folder / "adapter"
    adapter = {"interface": "slcan", "channel": link, "bitrate_bit_s": 1_000_000}
    stale = {"arm": ARM, "stale_after_s": STALE_AFTER_S}
    simulated = {"cable_tensions": "simulated_tensions"}
    calibration_file = run.folder / "arm.calibration"
    calibrate(calibration_file)
    calibrated = {"calibration_file": calibration_file}
    run.start("sim", node_command("sim", {"arm": ARM, "rate_hz": RATE_HZ}, simulated))
    run.start("amplifiers", node_command("can_emulator", {"arm": ARM, "channel": link}))
    run.start("driver", node_command("can_driver", stale | adapter))
    run.start("estimator", node_command("estimator", stale | calibrated))


def calibrate(path: Path) -> None:
    """Write the calibration of the simulated arm, by unloaded poses."""
    rng = np.random.default_rng(0)
    arm = open_arm(ARM)
    commands = rng.uniform(
        -CALIBRATED_BEND_RAD, CALIBRATED_BEND_RAD, (CALIBRATED_POSES, arm.joint_count)
    )
    tensions_n = solve_equilibrium(mechanism_of(arm), commands).tensions_n
    unloaded = []
    for command, tension_n in zip(commands, tensions_n, strict=True):
        several_n = np.tile(tension_n, (POSE_READINGS, 1))
        reading_n = read_tensions_n(several_n, arm.sensors, rng).mean(axis=0)
        unloaded.append(Unloaded(reading_n, command, POSE_READINGS, time.time_ns()))
    calibrator = Calibrator(FeltArm(arm), LawModel(find_model_of(arm, ARM), arm))
    write_calibration(path, calibrator.from_poses(unloaded), FeltArm(arm))


class Received(NamedTuple):
    """One wrench: its arrival (monotonic), segment (0: none), force (3,), N, moment (3,), N·m."""

    arrived_s: float
    segment: int
    force_n: Array
    moment_n_m: Array


class KillTrials(Operator):
    """Pushes the arm and commands it periodically, notes every wrench, and kills."""

    def __init__(self, chain: Mapping[str, Process]) -> None:
        super().__init__("watcher", seed=0)
        self._chain = chain
        self._wrenches: list[Received] = []
        self._gone_s: list[float] = []
        self._load_since_s = time.monotonic()
        self._contact_m = of_each_segment(self.arm.segments.contact_m, self.arm.segment_count)
        self.create_timer(LOAD_EVERY_S, self.publish_load)
        straight_rad = np.zeros(self.arm.joint_count)
        self.create_timer(COMMAND_EVERY_S, lambda: self.command(straight_rad))
        self.create_subscription(
            WrenchStamped,
            "estimator/wrench",
            self._on_wrench,
            qos_profile(Qos(depth=2000, reliable=True, lease_s=LEASE_S)),
            event_callbacks=SubscriptionEventCallbacks(liveliness=self._on_liveliness),
        )

    def bring_up(self) -> None:
        """Wait until wrenches follow the load."""
        self.spin_until(lambda: len(self._wrenches) > 100, "wrenches")
        self.spin(2.0)
        self._push()
        self._until_right("the first right wrench")

    def kill(self, victim: str) -> dict[str, float]:
        """Kill one and see it come back; times in s, NaN where one does not apply.

        Gives `others_lived`: whether every process is alive at the end; `stale_s`: from the kill
        to the first zero wrench, or for the estimator to the report of the subscriber's own
        middleware that it is gone; `right_after_set_up_s`: from the log line that the process is
        set up to the first wrench of those that are right and stay so; `wrong`: wrenches with
        another force than the load's, a second after the load last changed.

        Raises:
            TimeoutError: what should come did not come in time.
        """
        process = self._chain[victim]
        self._push()
        self._until_right(f"a right wrench before {victim} is killed")
        self.spin(float(self.rng.uniform(0.0, AT_ANY_MOMENT_S)))
        set_ups = len(self._set_up_epoch_s(victim))
        self._wrenches.clear()
        self._gone_s.clear()
        killed_s = process.kill()
        if self.rng.random() < 0.5:
            self._push()  # the process must not come back to the old load
        self.spin(float(self.rng.uniform(*DEAD_S)))
        stale_s = [received.arrived_s for received in self._wrenches if not received.segment]
        if victim == "estimator":
            stale_s = self._gone_s.copy()
        started_epoch_s = time.time()
        process.start()
        started_s = process.started_s
        self.spin_until(
            lambda: len(self._set_up_epoch_s(victim)) > set_ups, f"{victim} to be set up again"
        )
        right_s = self._until_right(f"a right wrench after {victim} came back", since_s=started_s)
        set_up_s = self._set_up_epoch_s(victim)[-1] - started_epoch_s
        return {
            "others_lived": all(each.alive for each in self._chain.values()),
            "stale_s": min((at_s for at_s in stale_s if at_s >= killed_s), default=nan) - killed_s,
            "right_after_set_up_s": right_s - started_s - set_up_s,
            "wrong": self._wrong(victim, started_s),
        }

    def _push(self) -> None:
        self.push(LEAST_N, MOST_N)
        self._load_since_s = time.monotonic()

    def _right(self, wrench: Received) -> bool:
        """Whether a wrench is the present load. The arm is straight: base axes are its own."""
        if wrench.segment != self.segment:
            return False
        limit_n = max(TOLERANCE_N, TOLERANCE * float(np.linalg.norm(self.force_n)))
        lever_m = self._contact_m[self.segment - 1]
        moment_n_m = np.cross([lever_m, 0.0, 0.0], self.force_n)
        off_n_m = np.linalg.norm(wrench.moment_n_m - moment_n_m)
        off_n = np.linalg.norm(wrench.force_n - self.force_n) if wrench.force_n.any() else 0.0
        return bool(off_n_m <= lever_m * limit_n and off_n <= limit_n)

    def _on_wrench(self, message: WrenchStamped) -> None:
        force = message.wrench.force
        torque = message.wrench.torque
        frame = message.header.frame_id
        segment = int(frame.rpartition("_")[2]) if frame.startswith("segment_") else 0
        force_n = np.array([force.x, force.y, force.z])
        moment_n_m = np.array([torque.x, torque.y, torque.z])
        self._wrenches.append(Received(time.monotonic(), segment, force_n, moment_n_m))

    def _on_liveliness(self, event: QoSLivelinessChangedInfo) -> None:
        if event.alive_count == 0:
            self._gone_s.append(time.monotonic())

    def _set_up_epoch_s(self, victim: str) -> list[float]:
        """The times at which a victim logged that it was set up, s since the epoch."""
        return [float(epoch_s) for epoch_s in re.findall(_SET_UP[victim], self._chain[victim].log)]

    def _wrong(self, victim: str, started_s: float) -> int:
        """Number of wrenches with a force that is not the load.

        A sim that comes back is unloaded, and swings when it takes the load again.
        """
        forces = [wrench for wrench in self._wrenches if wrench.moment_n_m.any()]
        settled_s = self._load_since_s + SETTLED_S
        back = [wrench.arrived_s for wrench in forces if wrench.arrived_s > started_s]
        if victim == "sim" and back:
            settled_s = max(settled_s, back[0] + SWING_S)
        return sum(wrench.arrived_s > settled_s and not self._right(wrench) for wrench in forces)

    def _until_right(self, what: str, since_s: float = 0.0) -> float:
        """When the first of `STEADY` right wrenches in a row came, of those that stay right."""
        wrenches = self._wrenches

        def right(one: Received) -> bool:
            return one.arrived_s >= since_s and self._right(one)

        self.spin_until(
            lambda: len(wrenches) >= STEADY and all(map(right, wrenches[-STEADY:])), what
        )
        return list(itertools.takewhile(right, reversed(wrenches)))[-1].arrived_s


def measure(times: int) -> dict[str, Any]:
    """All kills; statistics by victim."""
    with LiveRun() as run:
        start_chain(run)
        trials = KillTrials(run.processes)
        trials.bring_up()
        kills = [
            {"victim": victim, **trials.kill(victim)} for _ in range(times) for victim in _SET_UP
        ]
        codes = run.stop()
        trials.destroy_node()
    by_victim = pd.DataFrame(kills).groupby("victim", sort=False)
    statistics = {str(victim): _statistics(ones) for victim, ones in by_victim}
    return {
        "arm": ARM,
        "rate_hz": RATE_HZ,
        "stale_after_s": STALE_AFTER_S,
        "lease_s": LEASE_S,
        "kills": statistics,
        "exit codes": codes,
        "bars": {
            f"{victim}: {bar}": kept
            for victim, one in statistics.items()
            for bar, kept in _bars(one).items()
        },
    }


def _statistics(kills: pd.DataFrame) -> dict[str, Any]:
    return {
        "kills": len(kills),
        "others lived": int(kills["others_lived"].sum()),
        "wrong forces": int(kills["wrong"].sum()),
        **{
            name: {"seen": int(kills[name].count())}
            | harness.percentiles(kills[name].dropna(), ("median", "95 %", "worst"), 4)
            for name in ("stale_s", "right_after_set_up_s")
        },
    }


def _bars(one: dict[str, Any]) -> dict[str, bool]:
    stale = one["stale_s"]
    right = one["right_after_set_up_s"]
    said = stale["seen"] == one["kills"] and stale["worst"] <= STALE_WITHIN_S
    return {
        "the others go on": one["others lived"] == one["kills"],
        f"stale said within {STALE_WITHIN_S:g} s": said,
        f"right within {RIGHT_WITHIN_S:g} s of its being set up": right["worst"] <= RIGHT_WITHIN_S,
        "no wrong force": one["wrong forces"] == 0,
    }


def measure_lifecycle(loops: int) -> dict[str, Any]:
    """Bring the estimator up and down; its memory at the end of each loop."""
    made: deque[Subscription] = deque()
    wrenches: list[WrenchStamped] = []
    topics = itertools.cycle(("wrench", "wrench_base", "wrench_lower", "wrench_upper"))
    subscribed = itertools.count()

    def subscribe() -> None:
        topic = f"estimator/{next(topics)}"
        made.append(node.create_subscription(WrenchStamped, topic, wrenches.append, 10))
        if next(subscribed) >= SUBSCRIPTIONS:
            node.destroy_subscription(made.popleft())

    with LiveRun() as run:
        run.start("sim", node_command("sim", {"arm": ARM}))
        estimator = run.start("estimator", node_command("estimator", {"autostart": False}))
        node = SpunNode("restless")
        usage = Usage({"estimator": estimator})
        client = node.create_client(ChangeState, "estimator/change_state")
        node.spin_until(client.service_is_ready, "the estimator")
        node.create_timer(SUBSCRIBED_EVERY_S, subscribe)
        for loop in range(loops):
            for transition in LOOP:
                request = ChangeState.Request(transition=Transition(id=transition))
                done = client.call_async(request)
                node.spin_until(done.done, f"transition {transition} of loop {loop}")
                if not done.result().success:
                    raise SystemExit(f"transition {transition} of loop {loop} did not succeed")
                if transition == Transition.TRANSITION_ACTIVATE:
                    wrenches.clear()
                    node.spin_until(lambda: wrenches, "a wrench")
            run.check()
            usage.note()
        tracebacks = estimator.log.count("Traceback")
        codes = run.stop()
        node.destroy_node()
    memory = usage.memory()
    return {
        "arm": ARM,
        "loops": loops,
        "subscriptions made": next(subscribed),
        "tracebacks": tracebacks,
        "memory": memory,
        "exit codes": codes,
        "bars": {
            "every process ends well": not any(codes.values()) and not tracebacks,
            **memory_bars(memory, ["estimator"]),
        },
    }


def main() -> int:
    """Measure."""
    parser = harness.parser(__doc__, "results/kill.json or lifecycle.json")
    parser.add_argument("--times", type=int, default=50, help="kills of each")
    parser.add_argument("--lifecycle", type=int, metavar="LOOPS", help="loops, and no kills")
    given = parser.parse_args()
    if given.lifecycle:
        figures = measure_lifecycle(given.lifecycle)
        return harness.publish("lifecycle.json", figures, given, "rclpy")
    return harness.publish("kill.json", measure(given.times), given, "rclpy")


if __name__ == "__main__":
    sys.exit(main())
