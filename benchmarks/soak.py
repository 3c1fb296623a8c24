"""Soak: twelve channels as CAN frames at full rate through driver and estimator, minute by minute.

    python benchmarks/soak.py [--minutes 10] [--write]

Four processes: the amplifiers play a sequence of pushes as frames over slcan on a pseudo-terminal;
`can_driver` and `estimator` as a user starts them; and here a sink that receives every sample and
every wrench. First the packed amplifier at 1,000 samples a second, then for a minute twelve
CiA 404 amplifiers at 500, the most that a bus of 1 Mbit/s carries of them.

Everything is counted by value: the lowest bit of each of the twelve values spells the cycle's
number modulo 4096, and the rest is an arm under changing pushes, as its sensors read it. A sample
must be one that was sent, once and in its order, and be answered by a wrench with its stamp.
Frames that the pseudo-terminal does not take (it holds some 18 kB, a quarter of a second of these
frames) are counted separately. Latency is from when the last frame of a cycle was on the terminal
until the wrench was here, by one clock.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import harness
import numpy as np
from cantools.database.can import Database
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from harness import cpu_s, percentiles, rss_mb
from live_run import GROWTH_MB, PATIENCE_S, Arrivals, Integers, LiveRun, Log, SpunNode, memory
from numpy.typing import NDArray
from sensor_msgs.msg import JointState

from cablesense_base import Array, CableSenseError
from cablesense_msgs_py.qos import Qos
from cablesense_online.can.channel_map import ChannelMap, open_channel_map, signal_conversion
from cablesense_online.can.emulator import Emulator, SlcanPort
from cablesense_ros.endpoints import qos_profile
from cablesense_ros.processes import Process, node_command, wait_until
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_sim.replay import read_tensions_n

PACKED, CIA404 = "twelve_channel_amplifier", "cia404_amplifier"
ARM = "cdsm"
RATES_HZ = {PACKED: 1000.0, CIA404: 500.0}
CIA404_MINUTES = 1.0
LISTEN_AFTER_S = 2.5
"""Diagnostics come once a second: the last ones must be of after the end."""

PUSHES = 24
HOLD_S, REST_S, RAMP_S = 1.0, 0.6, 0.2
UNTOUCHED_S = 3.0
"""Before the first push, for the tare."""

REAL_TIME_PRIORITY = 10
BLOCK = 1000
"""Cycles whose tensions are made at once: in a cycle's own time numpy would be expensive."""

FALSE_FORCE_N = 1.0
"""A wrench beyond this while nothing pushes is a false force."""


class MarkedSequence(NamedTuple):
    """A sequence of T rows that is played again and again.

    Attributes:
        even: (T, M) readings in steps of the signals, every one even.
        step_n: tension of one step, N.
        force_n: (T,) magnitude of the push.
        segment: (T,) the pushed one, 0 for none.
        held: (T,) whether the push, or its absence, is steady.
    """

    even: Integers
    step_n: float
    force_n: Array
    segment: Integers
    held: NDArray[np.bool_]

    def steps(self, cycle: Integers) -> Integers:
        """(C, M) readings of cycles (C,), in steps."""
        bits = (cycle[:, None] >> np.arange(self.even.shape[1])) & 1
        return self.even[cycle % len(self.even)] + bits


def opened(map_name: str) -> tuple[ChannelMap, Database]:
    """The map of the arm's cables, and its database."""
    channel_map, database = open_channel_map(map_name)
    return channel_map.arranged(open_arm(ARM).cable_names), database


def marked_sequence(map_name: str) -> MarkedSequence:
    """The sequence of the arm in the steps of an amplifier; all channels have one step."""
    arm, rate_hz = open_arm(ARM), RATES_HZ[map_name]
    channel_map, database = opened(map_name)
    (step_n,) = {
        abs(signal_conversion(database, channel)[1] * channel.scale_n_per_unit)
        for channel in channel_map.channels.values()
    }
    rng = np.random.default_rng(0)
    rows = [
        (segment, angle_deg, force_n, from_n == to_n)
        for segment, angle_deg, from_n, to_n, seconds in _pushes(arm.segment_count, rng)
        for force_n in np.linspace(from_n, to_n, round(seconds * rate_hz), endpoint=False)
    ]
    segments, angles_deg, forces_n, held = (np.array(one) for one in zip(*rows, strict=True))
    mechanism = mechanism_of(arm)
    commands = np.zeros((len(rows), arm.joint_count))
    forces = normal_force_n(mechanism, commands, segments, angles_deg, forces_n)
    tensions = solve_equilibrium(mechanism, commands, forces).tensions_n
    readings = read_tensions_n(tensions, arm.sensors, rng)
    even = 2 * np.rint(readings / (2.0 * step_n)).astype(np.int64)
    return MarkedSequence(even, step_n, forces_n, segments, held)


def _pushes(
    segments: int, rng: np.random.Generator
) -> Iterator[tuple[int, float, float, float, float]]:
    """Segment, angle (degrees), force at the beginning and at the end (N), and seconds."""
    yield 0, 0.0, 0.0, 0.0, UNTOUCHED_S
    for number in range(PUSHES):
        segment = 1 + number % segments
        angle_deg, force_n = float(rng.uniform(0.0, 360.0)), float(rng.uniform(20.0, 100.0))
        yield segment, angle_deg, 0.0, force_n, RAMP_S
        yield segment, angle_deg, force_n, force_n, HOLD_S
        yield segment, angle_deg, force_n, 0.0, RAMP_S
        yield 0, 0.0, 0.0, 0.0, REST_S


def play(map_name: str, link: str, cycles: int, log: Path) -> int:
    """Wait for a line on stdin, play `cycles`, write the log.

    The log's `written_ns` is when the last frame of each cycle was on the pseudo-terminal, and
    `dropped` how many of its frames the terminal did not take.
    """
    sequence, rate_hz = marked_sequence(map_name), RATES_HZ[map_name]
    emulator = Emulator(*opened(map_name), lambda: SlcanPort(link))
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
        at = cycle % BLOCK
        if at == 0:
            rows = (sequence.steps(np.arange(cycle, cycle + BLOCK)) * sequence.step_n).tolist()
        wait_s = began_s + cycle / rate_hz - time.monotonic()
        if wait_s > 0.0:
            time.sleep(wait_s)
        before = emulator.dropped
        emulator.cycle(rows[at])
        written_ns[cycle] = time.time_ns()
        dropped[cycle] = emulator.dropped - before
    np.savez(log, written_ns=written_ns, dropped=dropped)
    print("played", flush=True)
    sys.stdin.readline()  # the port stays until the benchmark has received all
    emulator.close()
    return 0


def delivery(
    sequence: MarkedSequence, dropped: Integers, written_ns: Integers, tensions: Arrivals
) -> tuple[dict[str, Any], Integers]:
    """Counts of delivered cycles, by value; also the cycle (C,) of each sample, -1 for none.

    A sample spells its number modulo 2^M; its time of arrival gives the rest.
    """
    steps = np.rint(tensions.numbers / sequence.step_n).astype(np.int64)
    spelt = ((steps & 1) << np.arange(steps.shape[1])).sum(axis=1)
    guess = np.searchsorted(written_ns, tensions.arrived_ns) - 1
    half = 1 << (steps.shape[1] - 1)
    cycle = guess + (spelt - guess + half) % (2 * half) - half
    right = (cycle >= 0) & (cycle < len(written_ns))
    right &= (sequence.steps(cycle) == steps).all(axis=1)
    came = np.bincount(cycle[right], minlength=len(written_ns))
    lost = (dropped == 0) & (came == 0)
    return {
        "cycles played": len(written_ns),
        "cycles whole on the terminal": int((dropped == 0).sum()),
        "frames that the terminal did not take": int(dropped.sum()),
        "samples published, as heard": len(cycle),
        "samples with a value that was not sent": int((~right).sum()),
        "samples heard twice": int((came > 1).sum()),
        "samples out of order": int((np.diff(cycle[right]) <= 0).sum()),
        "cycles delivered but not published": int(lost.sum()),
    }, np.where(right, cycle, -1)


def answers(
    sequence: MarkedSequence,
    cycle: Integers,
    written_ns: Integers,
    tensions: Arrivals,
    wrenches: Arrivals,
) -> dict[str, Any]:
    """Whether each sample was answered, how soon, and how well."""
    order = np.argsort(wrenches.stamps_ns, kind="stable")
    stamps = wrenches.stamps_ns[order]
    at = np.minimum(np.searchsorted(stamps, tensions.stamps_ns), len(stamps) - 1)
    answered = stamps[at] == tensions.stamps_ns
    known = answered & (cycle >= 0)
    wrench = order[at][known]
    to_wrench = wrenches.arrived_ns[wrench] - written_ns[cycle[known]]
    row = cycle[known] % len(sequence.even)
    tared = np.cumsum(sequence.force_n[row] > 0.0) > 0
    judged = sequence.held[row] & tared
    force = np.linalg.norm(wrenches.numbers[wrench][:, :3], axis=1)
    pushed = judged & (sequence.segment[row] > 0)
    free = judged & (sequence.segment[row] == 0)
    hits = (wrenches.segments[wrench] == sequence.segment[row])[pushed]
    error_n = np.abs(force - sequence.force_n[row])[pushed]
    return {
        "samples answered": int(answered.sum()),
        "samples not answered": int((~answered).sum()),
        "latency from the last frame to the wrench (ms)": percentiles(
            to_wrench / 1e6, ("median", "99 %", "worst")
        ),
        "force": {
            "samples judged, pushed": int(pushed.sum()),
            "right segment (%)": round(100.0 * float(hits.mean()), 3),
            "error (N)": percentiles(error_n, ("median", "99 %", "worst")),
            "samples judged, untouched": int(free.sum()),
            "false forces": int((force[free] > FALSE_FORCE_N).sum()),
        },
    }


class Sink(SpunNode):
    """Receives from driver and estimator, and reads the processes' memory once a second.

    Attributes:
        tensions: all samples.
        wrenches: all wrenches.
        memory: seconds since the start and MB of each process.
        diagnostics: the latest values of each status.
    """

    def __init__(self, processes: Sequence[Process]) -> None:
        super().__init__("soak_sink")
        self.tensions, self.wrenches = Log(open_arm(ARM).cable_count), Log(6)
        self.diagnostics: dict[str, dict[str, str]] = {}
        self._processes = processes
        self.begin()
        for kind, topic, log in (
            (JointState, "cable_tensions", self.tensions),
            (WrenchStamped, "estimator/wrench", self.wrenches),
        ):
            qos = qos_profile(Qos(depth=5000, reliable=True))
            self.create_subscription(kind, topic, log.note, qos, raw=True)
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
    cycles = round(60.0 * minutes * RATES_HZ[map_name])
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
        sink = Sink(list(run.processes.values()))
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
        judged = _judged(map_name, dict(np.load(log)), sink)
        codes = list(run.stop().values())
        sink.destroy_node()
    return {"minutes": minutes, "cpu (cores)": cpu, **judged, "exit codes": codes}


def _send_line(process: Process, line: str) -> None:
    pipe = process.child.stdin
    assert pipe is not None
    pipe.write(f"{line}\n".encode())
    pipe.flush()


def _judged(map_name: str, played: dict[str, Any], sink: Sink) -> dict[str, Any]:
    sequence, written_ns = marked_sequence(map_name), played["written_ns"]
    tensions = sink.tensions.table()
    delivered, cycle = delivery(sequence, played["dropped"], written_ns, tensions)
    driver, estimator = (
        {
            key: int(value)
            for key, value in sink.diagnostics[name].items()
            if key.endswith("in all") and int(value)
        }
        for name in ("can_driver: samples", "estimator: cable_tensions")
    )
    return {
        "map": map_name,
        "delivery": delivered,
        "driver says": driver,
        "estimator says": estimator,
        **answers(sequence, cycle, written_ns, tensions, sink.wrenches.table()),
        "memory": memory(sink.memory),
    }


def bars(result: dict[str, Any]) -> dict[str, bool]:
    """The bars of each run."""
    delivered, grown = result["delivery"], result["memory"]
    wrong = ("with a value that was not sent", "heard twice", "out of order")
    refused = result["estimator says"].get("refused in all", 0)
    return {
        "none lost that the bus delivered": delivered["cycles delivered but not published"] == 0,
        "every sample sent, once, in order": not any(delivered[f"samples {one}"] for one in wrong),
        "every sample answered, or refused as too old": result["samples not answered"] <= refused,
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
    parser = harness.parser(__doc__, "results/soak.json")
    parser.add_argument("--minutes", type=float, default=10.0, help="of the packed amplifier")
    parser.add_argument("--role", choices=("amplifiers",), help=argparse.SUPPRESS)
    parser.add_argument("--map", help=argparse.SUPPRESS)
    parser.add_argument("--link", help=argparse.SUPPRESS)
    parser.add_argument("--log", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--cycles", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.role:
        return play(given.map, given.link, given.cycles, given.log)
    shorter = min(CIA404_MINUTES, given.minutes)
    runs = [measure(PACKED, given.minutes), measure(CIA404, shorter)]
    every = {f"{run['map']}: {bar}": kept for run in runs for bar, kept in bars(run).items()}
    result = {"arm": ARM, "runs": runs, "bars": every}
    return harness.publish("soak.json", result, given, "rclpy")


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (subprocess.SubprocessError, CableSenseError) as error:
        sys.exit(str(error))
