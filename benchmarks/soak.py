"""Soak: twelve channels as CAN frames at full rate through driver and estimator, minute by minute.

    python benchmarks/soak.py [--minutes 10] [--write]

Four processes: the amplifiers play a sequence of pushes as frames over slcan on a pseudo-terminal;
`can_driver` and `estimator` as a user starts them; and here a sink that receives every sample and
every wrench. First the packed amplifier at 1,000 samples a second, then for a minute twelve
CiA 404 amplifiers at 500, the most that a bus of 1 Mbit/s carries of them.

Everything is counted by value: the lowest bits of the twelve values spell the cycle's number, and
the rest is an arm under changing pushes. A sample must be one that was sent, once and in its
order, and be answered by a wrench with its stamp. Frames that the pseudo-terminal does not take
(it holds some 18 kB, a quarter of a second of these frames) are counted separately. Latency is
from when the last frame of a cycle was on the terminal until the wrench was here, by one clock.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
import sys
import time
from pathlib import Path
from typing import Any

import harness
import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from harness import percentiles
from live_run import (
    ARM,
    PATIENCE_S,
    Arrivals,
    Integers,
    LiveRun,
    Log,
    SpunNode,
    Usage,
    memory_bars,
)
from sensor_msgs.msg import JointState

from cablesense_base import Array
from cablesense_msgs_py.qos import Qos
from cablesense_online.can.channel_map import open_channel_map, signal_conversion
from cablesense_online.can.emulator import Emulator, SlcanPort
from cablesense_ros.endpoints import qos_profile
from cablesense_ros.processes import Process, node_command, wait_until
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n

PACKED = "twelve_channel_amplifier"
CIA404 = "cia404_amplifier"
RATES_HZ = {PACKED: 1000.0, CIA404: 500.0}
CIA404_MINUTES = 1.0
LISTEN_AFTER_S = 2.5
"""Diagnostics come once a second: the last ones must be of after the end."""

PUSHES = 24
PUSH_S = 2.0
UNTOUCHED_S = 3.0
"""Before the first push, for the tare."""

REAL_TIME_PRIORITY = 10
BLOCK = 1000
"""Cycles whose tensions are made at once: in a cycle's own time numpy would be expensive."""


class MarkedReadings:
    """Readings of an arm, untouched and then pushed again and again, marked with their cycle.

    The lowest bit of each reading is one of the cycle's number, exclusive or with the lowest: so
    no channel looks stuck, and the readings are as noisy as the arm's sensors. All channels have
    one step. The bits count to 4,096; which round of them it is follows from the order.
    """

    def __init__(self, map_name: str) -> None:
        arm = open_arm(ARM)
        rng = np.random.default_rng(0)
        self.map, self.database = open_channel_map(map_name)
        self.map = self.map.arranged(arm.cable_names)
        (self.step_n,) = {
            abs(signal_conversion(self.database, channel)[1] * channel.scale_n_per_unit)
            for channel in self.map.channels.values()
        }
        segments = 1 + np.arange(PUSHES) % arm.segment_count
        angles_deg = rng.uniform(0.0, 360.0, PUSHES)
        forces_n = rng.uniform(20.0, 100.0, PUSHES)
        mechanism = mechanism_of(arm)
        command = np.zeros((PUSHES, arm.joint_count))
        forces = normal_force_n(mechanism, command, segments, angles_deg, forces_n)
        untouched_n = solve_equilibrium(mechanism, command[:1]).tensions_n
        pushed_n = solve_equilibrium(mechanism, command, forces).tensions_n
        tensions_n = np.vstack([untouched_n, pushed_n])
        self._plain = 2 * np.rint(tensions_n / (2.0 * self.step_n)).astype(np.int64)
        self._shifts = np.arange(arm.cable_count)
        self._rate_hz = RATES_HZ[map_name]

    def steps(self, cycle: Integers) -> Integers:
        """(C, M) readings of cycles (C,), in steps."""
        pushed_s = cycle / self._rate_hz - UNTOUCHED_S
        row = np.where(pushed_s < 0.0, 0, 1 + (pushed_s // PUSH_S).astype(np.int64) % PUSHES)
        bits = (cycle[:, None] >> self._shifts) & 1
        bits[:, 1:] ^= bits[:, :1]
        return self._plain[row] + bits

    def cycles(self, tensions_n: Array, played: int) -> Integers:
        """The cycle (C,) of each sample (C, M); -1 of one that was not sent."""
        steps = np.rint(tensions_n / self.step_n).astype(np.int64)
        bits = steps & 1
        bits[:, 1:] ^= bits[:, :1]
        cycle = np.unwrap((bits << self._shifts).sum(axis=1), period=1 << len(self._shifts))
        sent = (cycle < played) & (self.steps(cycle) == steps).all(axis=1)
        return np.where(sent, cycle, -1)


def play(map_name: str, link: str, cycles: int, log: Path) -> int:
    """Wait for a line on stdin, play `cycles`, write the log.

    The log's `written_ns` is when the last frame of each cycle was on the pseudo-terminal, and
    `dropped` how many of its frames the terminal did not take.
    """
    readings = MarkedReadings(map_name)
    rate_hz = RATES_HZ[map_name]
    emulator = Emulator(readings.map, readings.database, lambda: SlcanPort(link))
    written_ns = np.zeros(cycles, dtype=np.int64)
    dropped = np.zeros(cycles, dtype=np.int64)
    print("ready", flush=True)
    if not sys.stdin.readline():
        return 1
    rows: list[list[float]] = []
    gc.collect()
    gc.freeze()
    with contextlib.suppress(OSError):  # hardware does not wait for this machine's scheduler
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REAL_TIME_PRIORITY))
    began_s = time.monotonic()
    for cycle in range(cycles):
        row = cycle % BLOCK
        if row == 0:
            rows = (readings.steps(np.arange(cycle, cycle + BLOCK)) * readings.step_n).tolist()
        wait_s = began_s + cycle / rate_hz - time.monotonic()
        if wait_s > 0.0:
            time.sleep(wait_s)
        before = emulator.dropped
        emulator.cycle(rows[row])
        written_ns[cycle] = time.time_ns()
        dropped[cycle] = emulator.dropped - before
    np.savez(log, written_ns=written_ns, dropped=dropped)
    print("played", flush=True)
    sys.stdin.readline()  # the port stays until the benchmark has received all
    emulator.close()
    return 0


def delivery(cycle: Integers, dropped: Integers) -> dict[str, int]:
    """Counts of delivered cycles, from the cycle (C,) of each sample, -1 for none."""
    known = cycle[cycle >= 0]
    came = np.bincount(known, minlength=len(dropped))
    return {
        "cycles played": len(dropped),
        "cycles whole on the terminal": int((dropped == 0).sum()),
        "frames that the terminal did not take": int(dropped.sum()),
        "samples published, as heard": len(cycle),
        "samples with a value that was not sent": len(cycle) - len(known),
        "samples heard twice": int((came > 1).sum()),
        "samples out of order": int((np.diff(known) <= 0).sum()),
        "cycles delivered but not published": int(((dropped == 0) & (came == 0)).sum()),
    }


def answers(
    cycle: Integers, written_ns: Integers, tensions: Arrivals, wrenches: Arrivals
) -> dict[str, Any]:
    """Whether each sample was answered, and how soon."""
    _, sample, wrench = np.intersect1d(tensions.stamps_ns, wrenches.stamps_ns, return_indices=True)
    known = cycle[sample] >= 0
    written_ns = written_ns[cycle[sample[known]]]
    latency_ms = (wrenches.arrived_ns[wrench[known]] - written_ns) / 1e6
    return {
        "samples answered": len(sample),
        "samples not answered": len(cycle) - len(sample),
        "latency from the last frame to the wrench (ms)": percentiles(
            latency_ms, ("median", "99 %", "worst")
        ),
    }


class Sink(SpunNode):
    """Receives all samples, all wrenches, and the latest values of each diagnostic status."""

    def __init__(self) -> None:
        super().__init__("soak_sink")
        self.tensions = Log(open_arm(ARM).cable_count)
        self.wrenches = Log(1)
        self.diagnostics: dict[str, dict[str, str]] = {}
        for kind, topic, log in (
            (JointState, "cable_tensions", self.tensions),
            (WrenchStamped, "estimator/wrench", self.wrenches),
        ):
            qos = qos_profile(Qos(depth=5000, reliable=True))
            self.create_subscription(kind, topic, log.note, qos, raw=True)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)

    def connected(self) -> bool:
        """Whether driver and estimator publish."""
        return bool(
            self.count_publishers("cable_tensions")
            and self.count_subscribers("cable_tensions") == 2
            and self.count_publishers("estimator/wrench")
            and self.diagnostics.get("can_driver: interface", {}).get("openings", "0") != "0"
        )

    def counted(self, status: str) -> dict[str, int]:
        """What a node has counted in all, other than 0."""
        values = self.diagnostics[status].items()
        counts = {key: int(value) for key, value in values if key.endswith("in all")}
        return {key: count for key, count in counts.items() if count}

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.diagnostics[status.name] = {entry.key: entry.value for entry in status.values}


def measure(map_name: str, minutes: float) -> dict[str, Any]:
    """Run one map."""
    cycles = round(60.0 * minutes * RATES_HZ[map_name])
    with LiveRun() as run:
        link = run.folder / "adapter"
        log = run.folder / "played.npz"
        arguments = [map_name, str(link), str(cycles), str(log)]
        amplifiers = run.start("amplifiers", [sys.executable, __file__, "--play", *arguments])
        wait_until(lambda: "ready" in amplifiers.log, PATIENCE_S, "not ready", run.check)
        adapter = {"interface": "slcan", "channel": link, "bitrate_bit_s": 1_000_000}
        run.start("driver", node_command("can_driver", {"arm": ARM, "map": map_name, **adapter}))
        run.start("estimator", node_command("estimator", {"arm": ARM}))
        sink = Sink()
        sink.spin_until(sink.connected, "samples and wrenches")
        sink.spin(1.0)
        _send_line(amplifiers)
        usage = Usage(run.processes)
        while "played" not in amplifiers.log:
            run.check()
            usage.note()
            sink.spin(1.0)
        cpu = usage.cores()
        sink.spin(LISTEN_AFTER_S)
        _send_line(amplifiers)
        played = dict(np.load(log))
        codes = run.stop()
        sink.destroy_node()
    tensions = sink.tensions.table()
    dropped = played["dropped"]
    cycle = MarkedReadings(map_name).cycles(tensions.numbers, len(dropped))
    return {
        "map": map_name,
        "minutes": minutes,
        "cpu (cores)": cpu,
        "delivery": delivery(cycle, dropped),
        "driver says": sink.counted("can_driver: samples"),
        "estimator says": sink.counted("estimator: cable_tensions"),
        **answers(cycle, played["written_ns"], tensions, sink.wrenches.table()),
        "memory": usage.memory(),
        "exit codes": codes,
    }


def _send_line(process: Process) -> None:
    pipe = process.child.stdin
    assert pipe is not None
    pipe.write(b"\n")
    pipe.flush()


def bars(result: dict[str, Any]) -> dict[str, bool]:
    """The bars of each run."""
    delivered = result["delivery"]
    wrong = ("with a value that was not sent", "heard twice", "out of order")
    refused = result["estimator says"].get("refused in all", 0)
    return {
        "none lost that the bus delivered": delivered["cycles delivered but not published"] == 0,
        "every sample sent, once, in order": not any(
            delivered[f"samples {fault}"] for fault in wrong
        ),
        "every sample answered, or refused as too old": result["samples not answered"] <= refused,
        **memory_bars(result["memory"], ("driver", "estimator")),
    }


def main() -> int:
    """Measure, or play the amplifiers."""
    parser = harness.parser(__doc__, "results/soak.json")
    parser.add_argument("--minutes", type=float, default=10.0, help="of the packed amplifier")
    parser.add_argument("--play", nargs=4, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.play:
        map_name, link, cycles, log = given.play
        return play(map_name, link, int(cycles), Path(log))
    runs = [measure(PACKED, given.minutes), measure(CIA404, min(CIA404_MINUTES, given.minutes))]
    all_bars = {f"{run['map']}: {bar}": kept for run in runs for bar, kept in bars(run).items()}
    result = {"arm": ARM, "runs": runs, "bars": all_bars}
    return harness.publish("soak.json", result, given, "rclpy")


if __name__ == "__main__":
    sys.exit(main())
