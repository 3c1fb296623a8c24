"""Latency of the estimator node and of a relay that does nothing, in the same run.

    python benchmarks/latency.py [--seconds 30] [--rate-hz 1000] [--write]

Three processes, each path in turn for a second at a time: publisher → estimator → sink, publisher
→ relay → sink. The relay, in the estimator's own executor, takes a sample as a message and
publishes it again, as a node usually does. At last the estimator alone, for as long as each path
had, to see whether a sample is lost. A sample's latency is the time from just before it is
published until the sink's callback begins. In process it is the time that the estimation takes
for a sample, one after another in a loop, without ROS, and for each of those that it takes
together where several wait.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import harness
import numpy as np
import rclpy
from estimation_settings import estimation_settings
from geometry_msgs.msg import WrenchStamped
from live_run import ARM, PATIENCE_S, Arrivals, Integers, LiveRun, Log, SpunNode
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from cablesense_base import Array
from cablesense_msgs_py.messages import ForceState
from cablesense_msgs_py.qos import PUBLISHER_QOS, SENSOR_QOS, Qos
from cablesense_msgs_py.serialized import restamped
from cablesense_online.estimation import Estimation
from cablesense_online.models import load_model
from cablesense_ros.endpoints import qos_profile
from cablesense_ros.node_process import run_node
from cablesense_ros.processes import node_command, wait_until
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_sim.replay import read_tensions_n

BLOCK_S = 1.0
WARM_UP_S = 2.0
PUSH = {"segment": 3, "angle_deg": 70.0, "magnitude_n": 40.0}
MEDIAN_BAR = 2.5
P99_BAR_US = 3000.0
IN_PROCESS_BAR_US = 400.0
PATHS = ("estimator", "relay")


class RelayNode(Node):
    """Publishes every message that it receives."""

    def __init__(self) -> None:
        super().__init__("relay")
        publisher = self.create_publisher(JointState, "relay_out", qos_profile(PUBLISHER_QOS))
        self.create_subscription(
            JointState, "relay_in", publisher.publish, qos_profile(SENSOR_QOS)
        )


def publish_all(blocks: int, file: Path, rate_hz: float) -> None:
    """Publish by each path in turn, then to the estimator alone; writes the stamps sent, ns."""
    rclpy.init()
    node = Node("source")
    publishers = {
        path: node.create_publisher(JointState, f"{path}_in", qos_profile(PUBLISHER_QOS))
        for path in PATHS
    }
    wait_until(
        lambda: all(publisher.get_subscription_count() for publisher in publishers.values()),
        PATIENCE_S,
        "the nodes under test are not up",
    )
    time.sleep(1.0)  # the other half of the discovery: their outputs to the sink
    unloaded, pushed = _samples()
    for path in PATHS:
        _publish(publishers[path].publish, unloaded, WARM_UP_S, rate_hz)
    sent: dict[str, list[int]] = {path: [] for path in PATHS}
    for _ in range(blocks):
        for path in PATHS:
            sent[path] += _publish(publishers[path].publish, pushed, BLOCK_S, rate_hz)
    alone_s = blocks * BLOCK_S
    sent["sustained"] = _publish(publishers["estimator"].publish, pushed, alone_s, rate_hz)
    np.savez(file, allow_pickle=False, **sent)
    node.destroy_node()


def _samples() -> list[list[bytes]]:
    """Serialized readings, unloaded and pushed, with the sensors' noise."""
    arm = open_arm(ARM)
    rng = np.random.default_rng(0)
    mechanism = mechanism_of(arm)
    command = np.zeros(arm.joint_count)
    force_n = normal_force_n(mechanism, command, **PUSH)

    def serialized(forces_n: Array | None) -> list[bytes]:
        tensions_n = solve_equilibrium(mechanism, command, forces_n).tensions_n
        readings_n = read_tensions_n(np.tile(tensions_n, (100, 1)), arm.sensors, rng)
        names = list(arm.cable_names)
        messages = [JointState(name=names, effort=reading_n.tolist()) for reading_n in readings_n]
        return [bytes(serialize_message(message)) for message in messages]

    return [serialized(None), serialized(force_n)]


def _publish(
    publish: Callable[[bytes], None], samples: Sequence[bytes], seconds: float, rate_hz: float
) -> list[int]:
    stamps_ns = []
    start_s = time.perf_counter()
    for i in range(round(seconds * rate_hz)):
        wait_s = start_s + i / rate_hz - time.perf_counter()
        if wait_s > 0.0:
            time.sleep(wait_s)
        stamps_ns.append(time.time_ns())
        publish(restamped(samples[i % len(samples)], stamps_ns[-1]))
    return stamps_ns


def _in_process(count: int, rate_hz: float, *, waiting: bool) -> dict[str, Any]:
    """How long the estimation takes for each of `count` samples of a contact, µs.

    One by one, or of as many together as it takes where they are `waiting`.
    """
    loaded = load_model(ARM, "")
    unloaded_and_pushed = _samples()
    settings = estimation_settings(tare_samples=100)
    estimation = Estimation(loaded.machine, loaded.contacts(settings), settings, 0.0)
    together = estimation.most_together if waiting else 1
    taken_us: list[float] = []
    stamp_ns = time.time_ns()
    for samples, repeats in zip(unloaded_and_pushed, (300, count), strict=True):
        taken_us.clear()
        for i in range(0, repeats, together):
            raws = []
            for number in range(i, i + together):
                stamp_ns += round(1e9 / rate_hz)
                raws.append(restamped(samples[number % len(samples)], stamp_ns))
            start_s = time.perf_counter()
            answers = list(estimation.samples(raws, stamp_ns, stamp_ns * 1e-9))
            taken_us.append((time.perf_counter() - start_s) * 1e6 / together)
    if answers[-1].force is not ForceState.CONTACT:
        raise SystemExit(f"the last sample is of a contact, was answered {answers[-1].force}")
    percentiles = harness.percentiles(taken_us, ("median", "99 %"), 1)
    return {"samples": count, "together": together, **percentiles}


def measure(seconds: float, rate_hz: float) -> dict[str, Any]:
    """Run everything; the latencies by path, and the bars."""
    with LiveRun() as run:
        sink = SpunNode("sink")
        logs = {path: Log(1) for path in PATHS}
        qos = qos_profile(Qos(depth=1000, reliable=True))
        for path, log in logs.items():
            kind = WrenchStamped if path == "estimator" else JointState
            sink.create_subscription(kind, f"{path}_out", log.note, qos, raw=True)
        run.start("relay", [sys.executable, __file__, "--relay"])
        # without samples between its turns, which is not to count as stale
        parameters = {"arm": ARM, "stale_after_s": 60.0, "tare_samples": 100}
        remaps = {"cable_tensions": "estimator_in", "~/wrench": "estimator_out"}
        run.start("estimator", node_command("estimator", parameters, remaps))
        file = run.folder / "sent.npz"
        role = [sys.executable, __file__, f"--seconds={seconds}", f"--rate-hz={rate_hz}"]
        source = run.start("source", [*role, "--source", str(file)])
        while source.alive:
            sink.spin(0.5)
        sink.spin(1.0)
        codes = run.stop()
        sink.destroy_node()
        if any(codes.values()):
            raise SystemExit(f"a process under test failed: {codes}\n{source.log}")
        sent = dict(np.load(file))
    count = round(seconds * rate_hz)
    in_process = _in_process(count, rate_hz, waiting=False)
    arrived = {path: log.table() for path, log in logs.items()}
    paths = {path: _latencies(sent[path], arrived[path]) for path in PATHS}
    sustained = _latencies(sent["sustained"], arrived["estimator"])
    ratio = paths["estimator"]["median_us"] / paths["relay"]["median_us"]
    return {
        "load": round(os.getloadavg()[0], 2),
        "arm": ARM,
        "rate_hz": rate_hz,
        "paths": paths,
        "sustained": {"seconds": seconds, **sustained},
        "in process, us": in_process,
        "in process, of those that wait, us": _in_process(count, rate_hz, waiting=True),
        "ratio of medians": round(ratio, 3),
        "bars": {
            "none lost while sustained": sustained["lost"] == 0,
            f"median at most {MEDIAN_BAR} times the relay's": ratio <= MEDIAN_BAR,
            f"p99 at most {P99_BAR_US:g} us": paths["estimator"]["p99_us"] <= P99_BAR_US,
            f"in process at most {IN_PROCESS_BAR_US:g} us": (
                in_process["median"] <= IN_PROCESS_BAR_US
            ),
        },
    }


def _latencies(sent_ns: Integers, arrived: Arrivals) -> dict[str, Any]:
    """One path's counts and latencies, µs."""
    _, _, received = np.intersect1d(sent_ns, arrived.stamps_ns, return_indices=True)
    latency_us = (arrived.arrived_ns[received] - arrived.stamps_ns[received]) * 1e-3
    median, p99, worst = np.percentile(latency_us, [50.0, 99.0, 100.0]).round(1).tolist()
    counts = {
        "sent": len(sent_ns),
        "received": len(received),
        "lost": len(sent_ns) - len(received),
    }
    return counts | {"median_us": median, "p99_us": p99, "worst_us": worst}


def main() -> int:
    """Measure, or play one of the parts."""
    parser = harness.parser(__doc__, "results/estimator_latency.json")
    parser.add_argument("--seconds", type=float, default=30.0, help="time for each path")
    parser.add_argument("--rate-hz", type=float, default=1000.0, help="of the samples")
    parser.add_argument("--source", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--relay", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.relay:
        return run_node(RelayNode, [])
    if given.seconds < BLOCK_S:
        parser.error(f"--seconds must be at least {BLOCK_S:g}")
    if given.source:
        publish_all(round(given.seconds / BLOCK_S), given.source, given.rate_hz)
        return 0
    harness.publish(
        "estimator_latency.json", measure(given.seconds, given.rate_hz), given, "rclpy"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
