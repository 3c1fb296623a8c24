"""Soak: twelve channels as CAN frames at full rate through driver and estimator, minute by minute.

    python benchmarks/soak.py [--minutes 10] [--write]
    python benchmarks/soak.py --lifecycle 200 [--write]

Four processes: the amplifiers play a sequence of pushes as frames over slcan on a pseudo-terminal,
each cycle bearing its number in its values; `can_driver` and `estimator` as a user starts them;
and here a sink that receives every sample and every wrench. First the packed amplifier at 1,000
samples a second, then for a minute twelve CiA 404 amplifiers at 500, the most that a bus of
1 Mbit/s carries of them.

Everything is counted by value: a sample must be one that was sent, once and in its order, and each
must be answered by a wrench that bears its stamp. Frames that the pseudo-terminal does not take
(it holds some 18 kB, a quarter of a second of these frames) are counted separately.
Latency is from when the last frame of a cycle was on the terminal until the wrench was here, by
one clock.

With `--lifecycle` an estimator of the sim's samples is configured, activated, deactivated and
cleaned up that often. It must answer each time, while this process subscribes to its wrenches and
unsubscribes some hundred times a second.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections import deque
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import harness
import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from harness import cpu_s, rss_mb
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from live_run import PATIENCE_S, LiveRun, Log, SpunNode
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from soak_sequence import answers, delivery, marked_sequence, memory, play

from cablesense_base import CableSenseError
from cablesense_msgs_py.qos import Qos
from cablesense_online.can.channel_map import open_channel_map
from cablesense_ros.endpoints import qos_profile
from cablesense_ros.processes import Process, node_command, wait_until
from cablesense_sim.arm import Arm, open_arm

PACKED, CIA404 = "twelve_channel_amplifier", "cia404_amplifier"
ARM = "cdsm"
RATES_HZ = {PACKED: 1000.0, CIA404: 500.0}
CIA404_MINUTES = 1.0
LISTEN_AFTER_S = 2.5
"""Diagnostics come once a second: the last ones must be of after the end."""

GROWTH_MB = 5.0
LOOP = (
    Transition.TRANSITION_CONFIGURE,
    Transition.TRANSITION_ACTIVATE,
    Transition.TRANSITION_DEACTIVATE,
    Transition.TRANSITION_CLEANUP,
)
SUBSCRIBED_EVERY_S, SUBSCRIPTIONS = 0.003, 3


class Sink(SpunNode):
    """Receives from driver and estimator, and reads the processes' memory once a second.

    Attributes:
        tensions: all samples.
        wrenches: all wrenches.
        memory: seconds since the start and MB of each process.
        diagnostics: the latest values of each status.
    """

    def __init__(self, cable_count: int, processes: Sequence[Process]) -> None:
        super().__init__("soak_sink")
        self.tensions, self.wrenches = Log(cable_count), Log(6)
        self.diagnostics: dict[str, dict[str, str]] = {}
        self._processes = processes
        self.begin()
        for kind, topic, log in (
            (JointState, "cable_tensions", self.tensions),
            (WrenchStamped, "estimator/wrench", self.wrenches),
        ):
            self.create_subscription(
                kind,
                topic,
                log.note,
                qos_profile(Qos(depth=5000, reliable=True)),
                raw=True,
                event_callbacks=SubscriptionEventCallbacks(message_lost=log.lost),
            )
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        self.create_timer(1.0, self._note_memory)

    def begin(self) -> None:
        """Count memory and processor time from here on."""
        self._began_s = time.monotonic()
        self._cpu_began_s = [cpu_s(one.pid) for one in self._processes]
        self.memory: list[tuple[float, dict[str, float]]] = []

    def cpu_share(self) -> dict[str, float]:
        """Cores that each process took since the beginning, on average."""
        elapsed_s = time.monotonic() - self._began_s
        return {
            one.name: round((cpu_s(one.pid) - began_s) / elapsed_s, 3)
            for one, began_s in zip(self._processes, self._cpu_began_s, strict=True)
        }

    def connected(self) -> bool:
        """Whether driver and estimator publish."""
        return bool(
            self.count_publishers("cable_tensions")
            and self.count_subscribers("cable_tensions") == 2
            and self.count_publishers("estimator/wrench")
            and self.diagnostics.get("can_driver: interface", {}).get("openings", "0") != "0"
        )

    def _note_memory(self) -> None:
        elapsed_s = time.monotonic() - self._began_s
        self.memory.append((elapsed_s, {one.name: rss_mb(one.pid) for one in self._processes}))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.diagnostics[status.name] = {one.key: one.value for one in status.values}


def measure(map_name: str, minutes: float) -> dict[str, Any]:
    """Run one map."""
    arm, cycles = open_arm(ARM), round(60.0 * minutes * RATES_HZ[map_name])
    with LiveRun() as run:
        link, log = run.folder / "adapter", run.folder / "played.npz"
        played = {"map": map_name, "link": link, "log": log, "cycles": cycles}
        given = [f"--{option}={value}" for option, value in played.items()]
        role = [sys.executable, __file__, "--role=amplifiers"]
        amplifiers = run.start("amplifiers", [*role, *given])
        wait_until(lambda: "ready" in amplifiers.log, PATIENCE_S, "not ready", run.check)
        adapter = {"interface": "slcan", "channel": link, "bitrate_bit_s": 1_000_000}
        driven = {"arm": ARM, "map": map_name, **adapter}
        run.start("driver", node_command("can_driver", driven))
        run.start("estimator", node_command("estimator", {"arm": ARM}))
        sink = Sink(arm.cable_count, list(run.processes.values()))
        sink.spin_until(sink.connected, "samples and wrenches")
        sink.spin(1.0)
        _send_line(amplifiers, "play")
        sink.begin()
        while "played" not in amplifiers.log:
            run.check()
            sink.spin(1.0)
        cpu = sink.cpu_share()
        sink.spin(LISTEN_AFTER_S)
        _send_line(amplifiers, "end")
        judged = _judged(arm, map_name, dict(np.load(log)), sink)
        codes = list(run.stop().values())
        sink.destroy_node()
    return {"minutes": minutes, "cpu (cores)": cpu, **judged, "exit codes": codes}


class Restless(SpunNode):
    """Subscribes to wrenches and unsubscribes all the time, and changes the estimator's state.

    Attributes:
        subscribed: how often.
        wrenches: received so far.
    """

    def __init__(self) -> None:
        super().__init__("restless")
        self.subscribed = self.wrenches = 0
        self._there: deque[Subscription] = deque()
        self._topics = cycle(("wrench", "wrench_base", "wrench_lower", "wrench_upper"))
        self._client = self.create_client(ChangeState, "estimator/change_state")
        self.create_timer(SUBSCRIBED_EVERY_S, self._subscribe)
        self.spin_until(self._client.service_is_ready, "the estimator")

    def change(self, transition: int) -> None:
        """Send the estimator through a transition.

        Raises:
            TimeoutError: it did not succeed.
        """
        done = self._client.call_async(ChangeState.Request(transition=Transition(id=transition)))
        self.spin(PATIENCE_S, done)
        if not (done.done() and done.result().success):
            raise TimeoutError(f"transition {transition} did not succeed")

    def hear(self) -> None:
        """Wait for a wrench."""
        before = self.wrenches
        self.spin_until(lambda: self.wrenches > before, "a wrench")

    def _subscribe(self) -> None:
        topic = f"estimator/{next(self._topics)}"
        self._there.append(self.create_subscription(WrenchStamped, topic, self._count, 10))
        self.subscribed += 1
        if len(self._there) > SUBSCRIPTIONS:
            self.destroy_subscription(self._there.popleft())

    def _count(self, _: WrenchStamped) -> None:
        self.wrenches += 1


def measure_lifecycle(loops: int) -> dict[str, Any]:
    """Bring the estimator up and down; its memory at the end of each loop."""
    notes: list[tuple[float, dict[str, float]]] = []
    with LiveRun() as run:
        run.start("sim", node_command("sim", {"arm": ARM}))
        estimator = run.start("estimator", node_command("estimator", {"autostart": False}))
        node, began_s = Restless(), time.monotonic()
        while len(notes) < loops:
            for transition in LOOP:
                node.change(transition)
                if transition == Transition.TRANSITION_ACTIVATE:
                    node.hear()
            run.check()
            notes.append((time.monotonic() - began_s, {"estimator": rss_mb(estimator.pid)}))
        tracebacks = estimator.log.count("Traceback")
        codes = run.stop()
        subscribed, wrenches = node.subscribed, node.wrenches
        node.destroy_node()
    grown = memory(notes)
    return {
        "loops": loops,
        "seconds": round(notes[-1][0], 1),
        "subscriptions made": subscribed,
        "wrenches received": wrenches,
        "tracebacks": tracebacks,
        "memory": grown,
        "exit codes": codes,
        "bars": {
            "every process ends well": not any(codes.values()) and not tracebacks,
            f"memory of the estimator grows by less than {GROWTH_MB:g} MB": (
                grown["estimator"]["growth at most (MB)"] < GROWTH_MB
            ),
        },
    }


def _send_line(process: Process, line: str) -> None:
    pipe = process.child.stdin
    assert pipe is not None
    pipe.write(f"{line}\n".encode())
    pipe.flush()


def _judged(arm: Arm, map_name: str, played: dict[str, Any], sink: Sink) -> dict[str, Any]:
    channel_map, database = open_channel_map(map_name)
    channel_map = channel_map.arranged(arm.cable_names)
    rate_hz, written_ns = RATES_HZ[map_name], played["written_ns"]
    sequence = marked_sequence(arm, channel_map, database, rate_hz)
    tensions = sink.tensions.table()
    delivered, cycle = delivery(sequence, played["dropped"], written_ns, tensions)
    names = ("can_driver: interface", "can_driver: samples", "estimator: cable_tensions")
    bus, samples, estimator = (sink.diagnostics[name] for name in names)
    faults = {
        key.removesuffix(" in all"): int(value)
        for key, value in samples.items()
        if key.endswith(" in all") and int(value)
    }
    return {
        "map": map_name,
        "delivery": delivered,
        "driver says": {
            "frames in all": int(bus["frames in all"]),
            "openings": int(bus["openings"]),
            **faults,
        },
        "estimator says": {
            key: int(estimator[key]) for key in ("dropped in all", "refused in all")
        },
        "lost on the way to the sink": {
            "cable_tensions": sink.tensions.lost_at_sink,
            "estimator/wrench": sink.wrenches.lost_at_sink,
        },
        **answers(sequence, cycle, written_ns, tensions, sink.wrenches.table()),
        "memory": memory(sink.memory),
    }


def bars(result: dict[str, Any]) -> dict[str, bool]:
    """The bars of each run."""
    delivered, grown = result["delivery"], result["memory"]
    return {
        "none lost that the bus delivered": delivered["cycles delivered but not published"] == 0,
        "every sample is one that was sent, once, in order": not any(
            delivered[key]
            for key in (
                "samples with a value that was not sent",
                "samples heard twice",
                "samples out of order",
            )
        ),
        "every sample answered, or refused as too old": result["samples not answered"]
        <= result["estimator says"]["refused in all"],
        "no false force": result["force"]["false forces"] == 0,
        **{
            f"memory of the {name} grows by less than {GROWTH_MB:g} MB": (
                grown[name]["growth at most (MB)"] < GROWTH_MB
            )
            for name in ("driver", "estimator")
        },
    }


def main() -> int:
    """Measure, or play the amplifiers."""
    parser = harness.parser(__doc__, "results/soak.json or lifecycle.json")
    parser.add_argument("--minutes", type=float, default=10.0, help="of the packed amplifier")
    parser.add_argument("--lifecycle", type=int, metavar="LOOPS", help="loops")
    parser.add_argument("--role", choices=("amplifiers",), help=argparse.SUPPRESS)
    parser.add_argument("--map", help=argparse.SUPPRESS)
    parser.add_argument("--link", help=argparse.SUPPRESS)
    parser.add_argument("--log", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--cycles", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.role:
        rate_hz = RATES_HZ[given.map]
        return play(ARM, given.map, given.link, rate_hz, given.cycles, given.log)
    if given.lifecycle:
        loops = measure_lifecycle(given.lifecycle)
        harness.publish("lifecycle.json", {**harness.origin("rclpy"), "arm": ARM, **loops}, given)
        return 0 if all(loops["bars"].values()) else 1
    minutes = {PACKED: given.minutes, CIA404: min(CIA404_MINUTES, given.minutes)}
    runs = []
    for map_name in (PACKED, CIA404):
        run = measure(map_name, minutes[map_name])
        runs.append({**run, "bars": bars(run)})
    result = {**harness.origin("rclpy"), "arm": ARM, "runs": runs}
    harness.publish("soak.json", result, given)
    return 0 if all(kept for run in runs for kept in run["bars"].values()) else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (subprocess.SubprocessError, CableSenseError) as error:
        sys.exit(str(error))
