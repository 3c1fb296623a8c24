"""Child processes that live and die together.

Each child leads its own process group, so that Ctrl-C in the terminal reaches the parent alone
and the parent ends the children in order. When the parent itself is killed, the kernel tells
each child (Linux, `PR_SET_PDEATHSIG`).

The demo's nodes as command lines, and the environment that keeps them on this machine.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TypeVar

from cablesense_base.errors import CableSenseError
from cablesense_ros.node_process import RANGE, prefer_quick_discovery

Found = TypeVar("Found")

GRACE_S = 5.0
"""How long a child may take to end after SIGTERM, before SIGKILL."""
POLL_S = 0.05
_PR_SET_PDEATHSIG = 1
_LOG_LINES_SHOWN = 6


class ChildError(CableSenseError):
    """A child process died, or did not come up."""

    exit_code = 1


@dataclass(frozen=True)
class ChildCommand:
    """What to start: a name for people, and the command line."""

    name: str
    command: Sequence[str]


@dataclass
class _Child:
    name: str
    process: subprocess.Popen[bytes]
    log: Path


class Processes:
    """Starts children on entry, ends every one of them on exit, whatever happened between."""

    def __init__(
        self,
        commands: Sequence[ChildCommand],
        log_dir: Path,
        environment: Mapping[str, str] | None = None,
        grace_s: float = GRACE_S,
    ) -> None:
        self._commands = commands
        self._log_dir = log_dir
        self._environment = dict(os.environ if environment is None else environment)
        self._grace_s = grace_s
        self._children: list[_Child] = []

    def __enter__(self) -> Processes:
        self._log_dir.mkdir(parents=True, exist_ok=True)
        try:
            for command in self._commands:
                self._start(command)
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end()

    @property
    def pids(self) -> dict[str, int]:
        """Process id of each child by name."""
        return {child.name: child.process.pid for child in self._children}

    def check(self) -> None:
        """Makes sure that all children live.

        Raises:
            ChildError: one has ended; names it, its exit code and the end of its log.
        """
        for child in self._children:
            code = child.process.poll()
            if code is not None:
                how = (
                    f"by signal {signal.Signals(-code).name}" if code < 0 else f"with code {code}"
                )
                raise ChildError(f"{child.name} ended {how}{self._last_words(child)}")

    def wait_for_line(self, name: str, start: str, timeout_s: float) -> str:
        """The rest of the first line in a child's log that begins with `start`.

        Raises:
            ChildError: a child died, or no such line came in time.
        """
        log = next(child.log for child in self._children if child.name == name)

        def found() -> str | None:
            for line in log.read_text(errors="replace").splitlines():
                if line.startswith(start):
                    return line[len(start) :].strip()
            return None

        return self.wait_until(found, timeout_s, f"{name} was not ready within {timeout_s:g} s")

    def wait_until(
        self, found: Callable[[], Found | None], timeout_s: float, otherwise: str
    ) -> Found:
        """The first thing that `found` gives, looked for while all children live.

        Raises:
            ChildError: a child died, or nothing was found in time; then `otherwise` says what.
        """
        until = time.monotonic() + timeout_s
        while time.monotonic() < until:
            self.check()
            result = found()
            if result is not None:
                return result
            time.sleep(POLL_S)
        raise ChildError(f"{otherwise}; logs are in {self._log_dir}")

    def run_until_child_ends(self) -> None:
        """Waits until a child ends.

        Raises:
            ChildError: always, as soon as one has.
        """
        while True:
            self.check()
            time.sleep(POLL_S)

    def _start(self, command: ChildCommand) -> None:
        log = self._log_dir / f"{command.name}.log"
        with log.open("wb") as sink:
            process = subprocess.Popen(
                list(command.command),
                stdin=subprocess.DEVNULL,
                stdout=sink,
                stderr=subprocess.STDOUT,
                env=self._environment,
                start_new_session=True,
                preexec_fn=_die_with_parent(os.getpid()),
            )
        self._children.append(_Child(command.name, process, log))

    def _end(self) -> None:
        with _no_interrupts():
            for child in reversed(self._children):
                _signal_group(child.process, signal.SIGTERM)
            until = time.monotonic() + self._grace_s
            for child in self._children:
                try:
                    child.process.wait(max(0.0, until - time.monotonic()))
                except subprocess.TimeoutExpired:
                    _signal_group(child.process, signal.SIGKILL)
                    child.process.wait()
                _signal_group(child.process, signal.SIGKILL)

    def _last_words(self, child: _Child) -> str:
        lines = child.log.read_text(errors="replace").strip().splitlines()[-_LOG_LINES_SHOWN:]
        return f" ({' | '.join(line.strip() for line in lines)})" if lines else ""


def _signal_group(process: subprocess.Popen[bytes], number: int) -> None:
    """Signals a child's whole group: what the child itself started must not outlive it."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, number)


class _no_interrupts:  # noqa: N801 - used as a statement
    """Puts off Ctrl-C and SIGTERM: the end, once begun, is carried through."""

    def __enter__(self) -> None:
        self._before = {
            number: signal.signal(number, signal.SIG_IGN)
            for number in (signal.SIGINT, signal.SIGTERM)
        }

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)


def _die_with_parent(parent_pid: int) -> Callable[[], None] | None:
    if sys.platform != "linux":
        return None
    libc = ctypes.CDLL(None)

    def arrange() -> None:
        libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent_pid:
            os._exit(1)

    return arrange


DOMAINS = 100
"""Domain ids that are safe on Linux go from 0 to 101; 0 is everyone's: the demo takes 1 … 100."""


def node_command(
    name: str,
    parameters: Mapping[str, str | int | float | bool],
    remaps: Mapping[str, str] | None = None,
) -> ChildCommand:
    """The command that runs `cablesense_ros.<name>_node` in this Python.

    `remaps` gives topics other names.
    """
    command = [sys.executable, "-m", f"cablesense_ros.{name}_node", "--ros-args"]
    for topic, other in (remaps or {}).items():
        command += ["-r", f"{topic}:={other}"]
    for key, value in parameters.items():
        command += ["-p", f"{key}:={json.dumps(value, ensure_ascii=False)}"]
    return ChildCommand(name, command)


def demo_environment() -> dict[str, str]:
    """This process's environment, with DDS kept on this machine.

    Unless ROS_DOMAIN_ID is set, the nodes get a ROS domain of their own. Who sets a discovery
    range or a profile of Fast DDS gets that.
    """
    environment = dict(os.environ)
    environment.setdefault(RANGE, "LOCALHOST")
    prefer_quick_discovery(environment)
    environment.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % DOMAINS))
    environment.setdefault("OMP_NUM_THREADS", "1")
    environment["PYTHONUNBUFFERED"] = "1"
    return environment
