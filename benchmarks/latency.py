"""Latency of the estimator node and of a relay that does nothing, in the same run.

    python benchmarks/latency.py [--seconds 30] [--write]

Three processes, each path in turn for a second at a time: publisher → estimator → sink, publisher
→ relay → sink. There are two relays in the estimator's own executor: one passes the serialized
message on (the leanest that rclpy allows), one takes it as a message and publishes it again (what
a node usually does). At last the estimator alone, for as long as each path had, to see whether a
sample is lost. A sample's latency is the time from just before it is published until the sink's
callback begins.
"""

from __future__ import annotations

import argparse
import os
import struct
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import harness
import numpy as np
from geometry_msgs.msg import WrenchStamped
from live_run import PATIENCE_S, LiveRun, Log
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from cablesense_msgs_py.qos import PUBLISHER, SENSOR, Qos
from cablesense_ros.endpoints import qos_profile
from cablesense_ros.node_process import run_node
from cablesense_ros.processes import node_command, wait_until
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_sim.replay import read_tensions_n

ARM, RATE_HZ = "cdsm", 1000
BLOCK_S = 1.0
WARM_UP_S = 2.0
PUSH = {"segment": 3, "angle_deg": 70.0, "magnitude_n": 40.0}
MEDIAN_BAR, P99_BAR_US = 2.0, 1000.0
PATHS = ("estimator", "raw_relay", "typed_relay")
SINK_QOS = Qos(depth=1000, reliable=True)

_STAMP = struct.Struct("<iI")
_STAMP_AT = 4


class RelayNode(Node):
    """Publishes every message that it receives, untouched or read and written."""

    def __init__(self, path: str) -> None:
        super().__init__(path)
        publisher = self.create_publisher(JointState, f"{path}_out", qos_profile(PUBLISHER))
        raw, qos = path == "raw_relay", qos_profile(SENSOR)
        self.create_subscription(JointState, f"{path}_in", publisher.publish, qos, raw=raw)


class SinkNode(Node):
    """Notes when what arrives by each path was sent, and when it came."""

    def __init__(self, file: Path) -> None:
        super().__init__("sink")
        self._file = file
        self._logs = {path: Log(1) for path in PATHS}
        for path, log in self._logs.items():
            kind = WrenchStamped if path == "estimator" else JointState
            qos = qos_profile(SINK_QOS)
            self.create_subscription(kind, f"{path}_out", log.note, qos, raw=True)

    def destroy_node(self) -> None:
        """Write the notes, then end."""
        tables = {path: log.table() for path, log in self._logs.items()}
        columns = {name: np.c_[one.stamps_ns, one.arrived_ns] for name, one in tables.items()}
        np.savez(self._file, allow_pickle=False, **columns)
        super().destroy_node()


def publish_schedule(arm: Arm, schedule: Sequence[tuple[str, float]]) -> dict[str, list[int]]:
    """Publish by each path in turn for the seconds given; give the stamps sent by each, ns."""
    node = Node("source")
    publishers = {
        path: node.create_publisher(JointState, f"{path}_in", qos_profile(PUBLISHER))
        for path in PATHS
    }
    wait_until(
        lambda: all(one.get_subscription_count() for one in publishers.values()),
        PATIENCE_S,
        "the nodes under test are not up",
    )
    time.sleep(1.0)  # the other half of the discovery: their outputs to the sink
    unloaded, pushed = _samples(arm)
    sent: dict[str, list[int]] = {path: [] for path in PATHS}
    for path in PATHS:
        _publish(publishers[path].publish, unloaded, WARM_UP_S)
    for path, seconds in schedule:
        sent[path] += _publish(publishers[path].publish, pushed, seconds)
    time.sleep(1.0)
    node.destroy_node()
    return sent


def _samples(arm: Arm) -> tuple[list[bytearray], list[bytearray]]:
    """Serialized readings, unloaded and pushed, with the sensors' noise."""
    mechanism = mechanism_of(arm)
    command = np.zeros(arm.joint_count)
    forces = normal_force_n(mechanism, command, **PUSH)
    rng = np.random.default_rng(0)
    serialized = []
    for load in (np.zeros_like(forces), forces):
        tensions = solve_equilibrium(mechanism, command, load).tensions_n
        readings = read_tensions_n(np.tile(tensions, (100, 1)), arm.sensors, rng)
        names = list(arm.cable_names)
        messages = [JointState(name=names, effort=reading.tolist()) for reading in readings]
        serialized.append([bytearray(serialize_message(message)) for message in messages])
    return serialized[0], serialized[1]


def _publish(
    publish: Callable[[bytes], None], samples: Sequence[bytearray], seconds: float
) -> list[int]:
    count, stamps = round(seconds * RATE_HZ), []
    start = time.perf_counter()
    for i in range(count):
        wait = start + i / RATE_HZ - time.perf_counter()
        if wait > 0.0:
            time.sleep(wait)
        sample = samples[i % len(samples)]
        stamp = time.time_ns()
        _STAMP.pack_into(sample, _STAMP_AT, *divmod(stamp, 1_000_000_000))
        publish(bytes(sample))
        stamps.append(stamp)
    return stamps


def measure(seconds: float) -> dict[str, Any]:
    """Run everything; the result by path, with its origin and the bars."""
    blocks = round(seconds / BLOCK_S)
    schedule = [(path, BLOCK_S) for _ in range(blocks) for path in PATHS]
    with LiveRun() as run:
        file, role = run.folder / "sink.npz", [sys.executable, __file__, "--role"]
        run.start("sink", [*role, "sink", "--file", str(file)])
        for relay in PATHS[1:]:
            run.start(relay, [*role, relay])
        # without samples between its turns, which is not to count as stale
        parameters = {"arm": ARM, "stale_after_s": 60.0, "tare_samples": 100}
        remaps = {"cable_tensions": "estimator_in", "~/wrench": "estimator_out"}
        run.start("estimator", node_command("estimator", parameters, remaps))
        sent = publish_schedule(open_arm(ARM), [*schedule, ("estimator", seconds)])
        codes = run.stop()
        if any(codes.values()):
            raise SystemExit(f"a process under test failed: {codes}")
        arrived = dict(np.load(file))
    interleaved = blocks * round(BLOCK_S * RATE_HZ)
    paths = {path: _latencies(sent[path][:interleaved], arrived[path]) for path in PATHS}
    sustained = _latencies(sent["estimator"][interleaved:], arrived["estimator"])
    ours = paths["estimator"]
    ratios = {relay: ours["median_us"] / paths[relay]["median_us"] for relay in PATHS[1:]}
    bars = {
        "none lost while sustained": sustained["lost"] == 0,
        f"median at most {MEDIAN_BAR} times typed_relay": ratios["typed_relay"] <= MEDIAN_BAR,
        f"p99 at most {P99_BAR_US:g} us": ours["p99_us"] <= P99_BAR_US,
    }
    return {
        "load": round(os.getloadavg()[0], 2),
        "arm": ARM,
        "rate_hz": RATE_HZ,
        "paths": paths,
        "sustained": {"seconds": seconds, **sustained},
        "ratios of medians": ratios,
        "bars": bars,
    }


def _latencies(sent: Sequence[int], arrived: NDArray[np.int64]) -> dict[str, Any]:
    """One path's counts and latencies, µs."""
    wanted = np.isin(arrived[:, 0], np.asarray(sent))
    latency = (arrived[wanted, 1] - arrived[wanted, 0]) * 1e-3
    received = len(np.unique(arrived[wanted, 0]))
    if not received:
        raise SystemExit("nothing arrived at the sink; see the log above")
    median, p99, worst = np.percentile(latency, [50.0, 99.0, 100.0]).round(1).tolist()
    counts = {"sent": len(sent), "received": received, "lost": len(sent) - received}
    return counts | {"median_us": median, "p99_us": p99, "worst_us": worst}


def main() -> int:
    """Measure, or play one of the parts."""
    parser = harness.parser(__doc__, "results/estimator_latency.json")
    parser.add_argument("--seconds", type=float, default=30.0, help="time for each path")
    parser.add_argument("--role", choices=("sink", *PATHS[1:]), help=argparse.SUPPRESS)
    parser.add_argument("--file", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.role == "sink":
        return run_node(lambda: SinkNode(given.file), [])
    if given.role:
        return run_node(lambda: RelayNode(given.role), [])
    if given.seconds < BLOCK_S:
        parser.error(f"--seconds must be at least {BLOCK_S:g}")
    harness.publish("estimator_latency.json", measure(given.seconds), given, "rclpy")
    return 0


if __name__ == "__main__":
    sys.exit(main())
