"""Processes of a live run as a user starts them, a node of this process, and its log."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import pandas as pd
import rclpy
from geometry_msgs.msg import WrenchStamped
from harness import CABLESENSE
from numpy.typing import NDArray
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.task import Future
from rclpy.utilities import try_shutdown

from cablesense_base import Array
from cablesense_ros.processes import Process, own_graph

Integers = NDArray[np.int64]

PATIENCE_S = 30.0
END_WITHIN_S = 20.0
"""A node under load may take so long to end by itself."""

FIRST_MINUTE_S, GROWTH_MB = 60.0, 5.0
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

    def record(self, name: str) -> Process:
        """Start a recorder of the running nodes, into `<name>.mcap` of the folder."""
        file = self.folder / f"{name}.mcap"
        return self.start(name, [*CABLESENSE, "record", "--out", str(file)])

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
        self._executor = EventsExecutor()
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


def load_message(segment: int, force_n: Array) -> WrenchStamped:
    """A force (3,), N, in base axes on a segment."""
    message = WrenchStamped()
    message.header.frame_id = f"segment_{segment}"
    force = message.wrench.force
    force.x, force.y, force.z = force_n.tolist()
    return message


class Log:
    """Arrivals of one topic."""

    def __init__(self, numbers: int) -> None:
        """A message ends with that number of `numbers`."""
        self._kind = np.dtype(
            [("s", "<i4"), ("ns", "<u4"), ("letter", "u1"), ("numbers", "<f8", numbers)]
        )
        self._arrived_ns: list[int] = []
        self._kept: list[bytes] = []

    def note(self, raw: bytes) -> None:
        """Keep the stamp, the last letter of segment_N and the numbers at the end."""
        self._arrived_ns.append(time.time_ns())
        self._kept.append(raw[4:12] + raw[24:25] + raw[9 - self._kind.itemsize :])

    def table(self) -> Arrivals:
        """All that came so far."""
        rows = np.frombuffer(b"".join(self._kept), self._kind)
        digits = rows["letter"].astype(np.int64) - ord("0")
        return Arrivals(
            np.array(self._arrived_ns, dtype=np.int64),
            rows["s"].astype(np.int64) * 1_000_000_000 + rows["ns"],
            rows["numbers"],
            np.where((digits >= 0) & (digits <= 9), digits, 0),
        )


class Arrivals(NamedTuple):
    """Messages in order: arrival and stamp (C,), ns, last numbers (C, n), segment (C,) or 0."""

    arrived_ns: Integers
    stamps_ns: Integers
    numbers: Array
    segments: Integers


def memory(notes: Sequence[tuple[float, dict[str, float]]]) -> dict[str, Any]:
    """MB of each process: at a minute, at the end, and by how much it grew at most.

    Runs of up to two minutes count from their first quarter.
    """
    taken = pd.DataFrame([mb for _, mb in notes], index=[elapsed_s for elapsed_s, _ in notes])
    later = taken[taken.index >= min(FIRST_MINUTE_S, taken.index[-1] / 4)]
    metrics = {
        "MB when settled": later.iloc[0],
        "MB at the end": later.iloc[-1],
        "growth at most (MB)": later.max() - later.iloc[0],
    }
    return dict(pd.DataFrame(metrics).round(2).to_dict(orient="index"))
