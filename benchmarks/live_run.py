"""Processes of a live run, as a user starts them, with their memory and cores; own nodes."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import pandas as pd
import rclpy
from geometry_msgs.msg import WrenchStamped
from harness import cpu_s, rss_mb
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.task import Future
from rclpy.utilities import try_shutdown
from sensor_msgs.msg import JointState

from cablesense_base import Array
from cablesense_msgs_py import topics
from cablesense_msgs_py.qos import COMMAND_QOS
from cablesense_ros.endpoints import qos_profile
from cablesense_ros.executor import make_executor
from cablesense_ros.processes import Process, own_graph
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import normal_force_n

Integers = NDArray[np.int64]

ARM = "cdsm"
PATIENCE_S = 30.0
END_WITHIN_S = 20.0
"""A node under load may take so long to end by itself."""

FIRST_MINUTE_S = 60.0
GROWTH_MB = 5.0
"""A process may not grow by more after its first minute."""


class LiveRun:
    """A folder, the processes that run in it, and ROS in this process: all end together.

    Attributes:
        folder: of logs and files; it goes with the run.
        processes: by name, in the order of their starts.
    """

    def __init__(self) -> None:
        os.environ.update(own_graph())
        self._temporary = tempfile.TemporaryDirectory()
        self.folder = Path(self._temporary.name)
        self.processes: dict[str, Process] = {}

    def __enter__(self) -> Self:
        rclpy.init()
        return self

    def start(self, name: str, command: Sequence[str]) -> Process:
        """Start a process."""
        self.processes[name] = Process(name, command, self.folder / f"{name}.log")
        return self.processes[name]

    def check(self) -> None:
        """Raise a `ProcessError` where a process has ended."""
        for process in self.processes.values():
            process.check()

    def stop(self) -> dict[str, int]:
        """End all processes, in the order of their starts; exit codes by name."""
        return {name: one.stop(END_WITHIN_S) for name, one in self.processes.items()}

    def __exit__(self, kind: object, error: object, where: object) -> None:
        self.stop()
        try_shutdown()
        if isinstance(error, TimeoutError):
            for name, process in self.processes.items():
                print(f"--- {name}\n{process.log[-1500:]}", file=sys.stderr)
        self._temporary.cleanup()


class SpunNode(Node):
    """A node whose callbacks run while it is spun."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._executor = make_executor()
        self._executor.add_node(self)

    def spin(self, seconds: float, until: Future | None = None) -> None:
        """Let callbacks run for a while, or until a future is done."""
        self._executor.spin_until_future_complete(until or Future(), timeout_sec=seconds)

    def spin_until(self, true: Callable[[], object], what: str) -> None:
        """Let callbacks run until something is true.

        Raises:
            TimeoutError: it did not become true within `PATIENCE_S`.
        """
        deadline_s = time.monotonic() + PATIENCE_S
        while not true():
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"waited {PATIENCE_S:g} s in vain for {what}")
            self.spin(0.02)

    def destroy_node(self) -> None:
        """End the callbacks, then the node."""
        self._executor.shutdown()
        super().destroy_node()


class Operator(SpunNode):
    """Pushes the arm and commands it.

    Attributes:
        segment: the pushed one.
        force_n: (3,) on it, in base axes.
    """

    def __init__(self, name: str, seed: int) -> None:
        super().__init__(name)
        self.arm = open_arm(ARM)
        self.rng = np.random.default_rng(seed)
        self._mechanism = mechanism_of(self.arm)
        self.segment = 1
        self.force_n = np.zeros(3)
        qos = qos_profile(COMMAND_QOS)
        self._loads = self.create_publisher(WrenchStamped, topics.APPLIED_WRENCH, qos)
        self._commands = self.create_publisher(JointState, topics.JOINT_COMMANDS, qos)

    def push(self, least_n: float, most_n: float) -> None:
        """Push a random segment from a random side, instead of the one before."""
        self.segment = int(self.rng.integers(1, self.arm.segment_count + 1))
        forces_n = normal_force_n(
            self._mechanism,
            np.zeros(self.arm.joint_count),
            segment=self.segment,
            angle_deg=float(self.rng.uniform(0.0, 360.0)),
            magnitude_n=float(self.rng.uniform(least_n, most_n)),
        )
        self.force_n = forces_n[self.segment - 1]
        self.publish_load()

    def publish_load(self) -> None:
        """State the force on every segment: zero on all others, and then the pushed one's."""
        segments = range(1, self.arm.segment_count + 1)
        for segment in sorted(segments, key=lambda number: number == self.segment):
            message = WrenchStamped()
            message.header.frame_id = f"segment_{segment}"
            if segment == self.segment:
                force = message.wrench.force
                force.x, force.y, force.z = self.force_n.tolist()
            self._loads.publish(message)

    def command(self, angles_rad: Array) -> None:
        """Command angles (2N,) of the joints."""
        message = JointState(name=list(self.arm.joint_names), position=angles_rad.tolist())
        message.header.stamp = self.get_clock().now().to_msg()
        self._commands.publish(message)


class Usage:
    """Memory and processor time of processes, from its creation on."""

    def __init__(self, processes: Mapping[str, Process]) -> None:
        self._pids = {name: process.pid for name, process in processes.items()}
        self._began_s = time.monotonic()
        self._cpu_began_s = self._cpu_s()
        self._memory_mb: dict[float, dict[str, float]] = {}

    def _cpu_s(self) -> pd.Series:
        return pd.Series({name: cpu_s(pid) for name, pid in self._pids.items()})

    def note(self) -> None:
        """Read the memory."""
        elapsed_s = time.monotonic() - self._began_s
        self._memory_mb[elapsed_s] = {name: rss_mb(pid) for name, pid in self._pids.items()}

    def cores(self) -> dict[str, float]:
        """Mean number of cores that each process has used."""
        share = (self._cpu_s() - self._cpu_began_s) / (time.monotonic() - self._began_s)
        return dict(share.round(3).to_dict())

    def memory(self) -> dict[str, Any]:
        """MB of each process: at a minute, at the end, and by how much it grew at most.

        Runs of up to two minutes count from their first quarter.
        """
        taken = pd.DataFrame.from_dict(self._memory_mb, orient="index")
        later = taken[taken.index >= min(FIRST_MINUTE_S, taken.index[-1] / 4)]
        metrics = {
            "MB when settled": later.iloc[0],
            "MB at the end": later.iloc[-1],
            "growth at most (MB)": later.max() - later.iloc[0],
        }
        return dict(pd.DataFrame(metrics).round(2).to_dict(orient="index"))


def memory_bars(memory: Mapping[str, Any], names: Iterable[str]) -> dict[str, bool]:
    """Whether processes have grown by less than the limit."""
    return {
        f"memory of the {name} grows by less than {GROWTH_MB:g} MB": (
            memory[name]["growth at most (MB)"] < GROWTH_MB
        )
        for name in names
    }


class Arrivals(NamedTuple):
    """Messages in order: arrival and stamp (C,), ns, and the numbers at their ends (C, n)."""

    arrived_ns: Integers
    stamps_ns: Integers
    numbers: Array


class Log:
    """Arrivals of one topic."""

    def __init__(self, numbers: int) -> None:
        """A message ends with that number of `numbers`."""
        self._kind = np.dtype([("s", "<i4"), ("ns", "<u4"), ("numbers", "<f8", numbers)])
        self._arrived_ns: list[int] = []
        self._kept: list[bytes] = []

    def note(self, raw: bytes) -> None:
        """Keep the stamp and the numbers at the end."""
        self._arrived_ns.append(time.time_ns())
        self._kept.append(raw[4:12] + raw[8 - self._kind.itemsize :])

    def table(self) -> Arrivals:
        """All that came so far."""
        rows = np.frombuffer(b"".join(self._kept), self._kind)
        stamps_ns = rows["s"].astype(np.int64) * 1_000_000_000 + rows["ns"]
        return Arrivals(np.array(self._arrived_ns, dtype=np.int64), stamps_ns, rows["numbers"])
