"""Soak: twelve channels as CAN frames at full rate through driver and estimator, minute by minute.

    python benchmarks/soak.py [--minutes 10] [--write]

Four processes: the amplifiers play a course of pushes as frames over slcan on a pseudo-terminal,
each cycle bearing its number in its values; `can_driver` and `estimator` as a user starts them;
and here a sink that hears every sample and every wrench. First the packed amplifier at 1,000
samples a second, then for a minute twelve CiA 404 amplifiers at 500, the most that a bus of
1 Mbit/s carries of them.

Everything is counted by value: a sample must be one that was sent, once and in its order, and each
must be answered by a wrench that bears its stamp. What the pseudo-terminal does not take (it holds
some 18 kB, a quarter of a second of these frames) the bus has not delivered; it is counted apart.
Latency is from when the last frame of a cycle was on the terminal until the wrench was here, by
one clock.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import harness
import numpy as np
import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.task import Future
from rclpy.utilities import try_shutdown
from soak.course import line_limits, marked_course, play
from soak.figures import answers, delivery, memory
from soak.sink import Sink

from cablesense_online.can.channel_map import open_channel_map
from cablesense_ros.discovery import own_graph
from cablesense_ros.processes import Process, node_command, wait_until
from cablesense_sim.arm import open_arm

PACKED, CIA404 = "twelve_channel_amplifier", "cia404_amplifier"
RATES_HZ = {PACKED: 1000.0, CIA404: 500.0}
CIA404_MINUTES = 1.0
UP_WITHIN_S = 30.0
LISTEN_AFTER_S = 2.5
"""Diagnostics come once a second: the last ones must be of after the end."""

GROWTH_MB = 5.0


class Soak:
    """One run of one map."""

    def __init__(self, arm_name: str, map_name: str, seconds: float, folder: Path) -> None:
        self._rate_hz = RATES_HZ[map_name]
        self._cycles = round(seconds * self._rate_hz)
        self._arm, self._map_name = open_arm(arm_name), map_name
        link, self._log = folder / "adapter", folder / "played.npz"
        amplifiers = [
            *(sys.executable, __file__, "--role", "amplifiers", "--arm", arm_name),
            *("--map", map_name, "--link", str(link), "--log", str(self._log)),
            *("--cycles", str(self._cycles)),
        ]
        driver = node_command(
            "can_driver",
            {
                "arm": arm_name,
                "map": map_name,
                "interface": "slcan",
                "channel": link,
                "bitrate_bit_s": 1_000_000,
            },
        )
        estimator = node_command("estimator", {"arm": arm_name})
        first = Process("amplifiers", amplifiers, folder / "amplifiers.log")
        self._processes = [first]
        wait_until(
            lambda: first.line("ready"), UP_WITHIN_S, "the amplifiers are not ready", first.check
        )
        self._processes += [
            Process(name, command, folder / f"{name}.log")
            for name, command in (("driver", driver), ("estimator", estimator))
        ]

    def run(self) -> dict[str, Any]:
        """Play it all and give the figures."""
        rclpy.init()
        pids = {one.name: one.pid for one in self._processes}
        sink = Sink(self._cycles + 5000, self._arm.cable_count, pids)
        executor = EventsExecutor()
        executor.add_node(sink)
        try:
            self._bring_up(executor, sink)
            self._tell("play")
            sink.begin()
            self._spin(executor, lambda: "played" in self._processes[0].log)
            cpu = sink.cpu_share()
            self._spin_for(executor, LISTEN_AFTER_S)
            self._tell("end")
            return {"cpu (cores)": {k: round(v, 3) for k, v in cpu.items()}, **self._judge(sink)}
        finally:
            executor.shutdown()
            sink.destroy_node()
            try_shutdown()

    def end(self) -> list[int]:
        """End every process; their exit codes."""
        return [one.stop(harness.END_WITHIN_S) for one in self._processes]

    def _bring_up(self, executor: EventsExecutor, sink: Sink) -> None:
        deadline_s = time.monotonic() + UP_WITHIN_S
        while not (
            sink.count_publishers("cable_tensions")
            and sink.count_subscribers("cable_tensions") == 2
            and sink.count_publishers("estimator/wrench")
            and sink.values.get(("can_driver: interface", "openings"), "0") != "0"
        ):
            if time.monotonic() > deadline_s or not all(one.alive for one in self._processes):
                logs = "\n".join(one.log for one in self._processes)
                raise SystemExit(f"the nodes did not come up within {UP_WITHIN_S:g} s\n{logs}")
            self._spin_for(executor, 0.2)
        self._spin_for(executor, 1.0)

    def _tell(self, word: str) -> None:
        pipe = self._processes[0].child.stdin
        assert pipe is not None
        pipe.write(f"{word}\n".encode())
        pipe.flush()

    def _spin(self, executor: EventsExecutor, ended: Callable[[], bool]) -> None:
        while not ended():
            if not all(one.alive for one in self._processes):
                raise SystemExit("\n".join(one.log for one in self._processes))
            self._spin_for(executor, 1.0)

    @staticmethod
    def _spin_for(executor: EventsExecutor, seconds: float) -> None:
        executor.spin_until_future_complete(Future(), timeout_sec=seconds)

    def _judge(self, sink: Sink) -> dict[str, Any]:
        channel_map, database = open_channel_map(self._map_name)
        channel_map = channel_map.arranged(self._arm.cable_names)
        course = marked_course(self._arm, channel_map, database, self._rate_hz)
        played = dict(np.load(self._log))
        delivered, cycle = delivery(
            course, played["dropped"], played["written_ns"], sink.tensions, self._rate_hz
        )
        names = {channel.message for channel in channel_map.channels.values()}
        names |= {channel_map.counter.message} if channel_map.counter else set()
        lengths = [database.get_message_by_name(name).length for name in sorted(names)]
        said = sink.values
        faults = {
            key.removesuffix(" in all"): int(value)
            for (status, key), value in said.items()
            if status == "can_driver: samples" and key.endswith(" in all") and int(value)
        }
        return {
            "map": self._map_name,
            "amplifiers scheduled in real time": bool(played["real_time"]),
            "delivery": delivered,
            "driver says": {
                "frames in all": int(said["can_driver: interface", "frames in all"]),
                "openings": int(said["can_driver: interface", "openings"]),
                "frames of a cycle": len(lengths),
                **faults,
            },
            "estimator says": {
                key: int(said["estimator: cable_tensions", key])
                for key in ("dropped in all", "refused in all")
            },
            "lost on the way to the sink": {
                "cable_tensions": sink.tensions.lost_at_sink,
                "estimator/wrench": sink.wrenches.lost_at_sink,
            },
            **answers(course, cycle, played["written_ns"], sink.tensions, sink.wrenches),
            "memory": memory(sink.memory),
            "limits": line_limits(lengths, self._rate_hz),
        }


def measure(arm_name: str, map_name: str, minutes: float) -> dict[str, Any]:
    """Run one map."""
    with tempfile.TemporaryDirectory() as folder:
        soak = Soak(arm_name, map_name, 60.0 * minutes, Path(folder))
        try:
            result = soak.run()
        finally:
            codes = soak.end()
    return {"minutes": minutes, **result, "exit codes": codes}


def bars(result: dict[str, Any]) -> dict[str, bool]:
    """What must hold of each run."""
    delivered, grown = result["delivery"], result["memory"]
    return {
        "none lost that the bus delivered": delivered["cycles delivered but not published"] == 0,
        "every sample is one that was sent, once, in order": not any(
            delivered[key]
            for key in (
                "samples with a value that was not sent",
                "samples of two cycles",
                "samples heard twice",
                "samples out of order",
            )
        ),
        "every sample answered, or refused as too old": result["samples not answered"]
        <= result["estimator says"]["refused in all"],
        "no false force": result["force"]["false forces"] == 0,
        **{
            f"memory of the {name} grows by less than {GROWTH_MB:g} MB": max(
                grown[name]["growth at most (MB)"], grown[name]["growth by the fitted line (MB)"]
            )
            < GROWTH_MB
            for name in ("driver", "estimator")
        },
    }


def main() -> int:
    """Measure, or play the amplifiers."""
    parser = harness.parser(__doc__, "results/soak.json")
    parser.add_argument("--minutes", type=float, default=10.0, help="of the packed amplifier")
    parser.add_argument("--arm", default="cdsm", help="bundled arm, or a path")
    parser.add_argument("--only", choices=(PACKED, CIA404), help="one map alone")
    parser.add_argument("--role", choices=("amplifiers",), help=argparse.SUPPRESS)
    parser.add_argument("--map", help=argparse.SUPPRESS)
    parser.add_argument("--link", help=argparse.SUPPRESS)
    parser.add_argument("--log", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--cycles", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.role:
        rate_hz = RATES_HZ[given.map]
        return play(given.arm, given.map, given.link, rate_hz, given.cycles, given.log)
    os.environ.update(own_graph())
    minutes = {PACKED: given.minutes, CIA404: min(CIA404_MINUTES, given.minutes)}
    runs = []
    for map_name in [given.only] if given.only else [PACKED, CIA404]:
        run = measure(given.arm, map_name, minutes[map_name])
        runs.append({**run, "bars": bars(run)})
    command = f"python benchmarks/soak.py --minutes {given.minutes:g} --write"
    result = {**harness.origin(command, ["rclpy"]), "arm": given.arm, "runs": runs}
    print(json.dumps(result, indent=2))
    if given.write:
        harness.write_result("soak.json", result)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except subprocess.SubprocessError as error:
        sys.exit(str(error))
