"""Processes of a live run as a user starts them, and a node of this process beside them."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Self

import rclpy
from harness import CABLESENSE
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.task import Future
from rclpy.utilities import try_shutdown

from cablesense_ros.discovery import own_graph
from cablesense_ros.processes import Process

PATIENCE_S = 30.0
END_WITHIN_S = 20.0
"""A node under load may take so long to end by itself."""


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
