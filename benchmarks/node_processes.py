"""One node process under test: started as a user would, its output in a file, always ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType

from cablesense_ros.discovery import prefer_quick_discovery

END_WITHIN_S = 20.0


def own_graph() -> None:
    """Keep this process and its children on this machine, in a ROS domain of their own."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    prefer_quick_discovery()


def node_command(
    module: str, parameters: Mapping[str, object], remaps: Mapping[str, str] | None = None
) -> list[str]:
    """The command line of a node of this package in this Python."""
    command = [sys.executable, "-m", f"cablesense_ros.{module}", "--ros-args"]
    for topic, other in (remaps or {}).items():
        command += ["-r", f"{topic}:={other}"]
    for name, value in parameters.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        command += ["-p", f"{name}:={text}"]
    return command


def wait_until(true: Callable[[], object], within_s: float) -> bool:
    """Look every 20 ms; give whether it became true in time."""
    deadline_s = time.monotonic() + within_s
    while not true():
        if time.monotonic() > deadline_s:
            return False
        time.sleep(0.02)
    return True


class NodeProcess:
    """A child process that can be killed and started again.

    Attributes:
        started_s: when it was last started, monotonic.
    """

    def __init__(self, name: str, command: Sequence[str], log: Path) -> None:
        self.name = name
        self._command = list(command)
        self._log = log
        self.start()

    def start(self) -> None:
        """Start it, or start it again after its end."""
        with self._log.open("ab") as sink:
            self.started_s = time.monotonic()
            self.process = subprocess.Popen(
                self._command, stdin=subprocess.PIPE, stdout=sink, stderr=subprocess.STDOUT
            )

    @property
    def pid(self) -> int:
        """Its process id."""
        return self.process.pid

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self.process.poll() is None

    def log(self) -> str:
        """All that it has printed so far."""
        return self._log.read_text(encoding="utf-8", errors="replace")

    def kill(self) -> float:
        """Kill it as nothing can refuse (SIGKILL); give the monotonic time of that."""
        killed_s = time.monotonic()
        self.process.send_signal(signal.SIGKILL)
        self.process.wait(timeout=END_WITHIN_S)
        return killed_s

    def stop(self) -> int:
        """End it as Ctrl-C does; give its exit code."""
        if self.alive:
            self.process.send_signal(signal.SIGINT)
        try:
            return self.process.wait(timeout=END_WITHIN_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()

    def __enter__(self) -> NodeProcess:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()
