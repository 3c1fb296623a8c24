"""Nodes and other commands as child processes, and which nodes find each other; without rclpy.

Each child leads its own process group, so that Ctrl-C in the terminal reaches the parent alone
and the parent ends the children in order. When the parent itself is killed, the kernel ends each
child (Linux, `PR_SET_PDEATHSIG`). All that a child prints goes to a log file.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import functools
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

from cablesense_base import CableSenseError
from cablesense_base.installation import config_path

Found = TypeVar("Found")

GRACE_S = 5.0
"""How long a child may take to end after the first signal, before SIGKILL."""
_POLL_S = 0.02
"""How often it is looked whether a process has ended."""
_PR_SET_PDEATHSIG = 1
"""Of prctl(2): a process gets a signal when its parent ends."""
_LOG_LINES_SHOWN = 6
"""Last lines of a log that an error shows."""


class ProcessError(CableSenseError):
    """A child process ended, or was not ready in time."""

    exit_code = 1


def node_command(
    name: str,
    parameters: Mapping[str, object] | None = None,
    remaps: Mapping[str, str] | None = None,
    namespace: str = "",
) -> list[str]:
    """The command line that runs `cablesense_ros.<name>_node`, or a module with a dot in its name.

    Parameters other than numbers, truth values and text are given as their text.
    """
    module = name if "." in name else f"cablesense_ros.{name}_node"
    command = [sys.executable, "-m", module, "--ros-args"]
    for topic, other in (({"__ns": namespace} if namespace else {}) | dict(remaps or {})).items():
        command += ["-r", f"{topic}:={other}"]
    for key, value in (parameters or {}).items():
        command += ["-p", f"{key}:={json.dumps(value, ensure_ascii=False, default=str)}"]
    return command


def wait_until(
    found: Callable[[], Found | None],
    within_s: float,
    otherwise: str,
    check: Callable[[], object] = lambda: None,
) -> Found:
    """The first true value of `found`, called again and again, `check` before each time.

    Raises:
        ProcessError: nothing was found in time; with the text `otherwise`.
    """
    deadline_s = time.monotonic() + within_s
    while True:
        check()
        if result := found():
            return result
        if time.monotonic() > deadline_s:
            raise ProcessError(otherwise)
        time.sleep(_POLL_S)


class Process:
    """One child process, called `name` in errors; it can be killed and started again.

    `started_s` is the monotonic time of its last start; the stdin of `child` is a pipe.
    """

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        log: Path,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        """Start it; its log is continued where the file exists."""
        self.name = name
        self._command = list(command)
        self._log = log
        self._environment = None if environment is None else dict(environment)
        self.start()

    def start(self) -> None:
        """Start it, or start it again after its end."""
        self._log.touch(mode=0o600)  # the page's token is in its log
        with self._log.open("ab") as sink:
            self.started_s = time.monotonic()
            self.child = subprocess.Popen(
                self._command,
                stdin=subprocess.PIPE,
                stdout=sink,
                stderr=subprocess.STDOUT,
                env=self._environment,
                start_new_session=True,
                preexec_fn=_die_with_parent(os.getpid()),
            )

    @property
    def pid(self) -> int:
        """Its process id."""
        return self.child.pid

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self.child.poll() is None

    @property
    def log(self) -> str:
        """Its whole output."""
        return self._log.read_text(encoding="utf-8", errors="replace")

    def check(self) -> None:
        """Raise a `ProcessError`, with exit code and the end of the log, where it has ended."""
        code = self.child.poll()
        if code is None:
            return
        how = f"by signal {signal.Signals(-code).name}" if code < 0 else f"with code {code}"
        lines = self.log.strip().splitlines()[-_LOG_LINES_SHOWN:]
        end = f" ({' | '.join(line.strip() for line in lines)})" if lines else ""
        raise ProcessError(f"{self.name} ended {how}{end}")

    def wait(self, within_s: float | None = GRACE_S) -> int:
        """Its exit code, once it has ended by itself.

        Raises:
            subprocess.TimeoutExpired: it still runs.
        """
        code = self.child.wait(timeout=within_s)
        if self.child.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self.child.stdin.close()
        return code

    def signal(self, number: int) -> None:
        """Send a signal to it and to its own children."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, number)

    def kill(self) -> float:
        """Kill it as nothing can refuse (SIGKILL); gives the monotonic time of that."""
        killed_s = time.monotonic()
        self.signal(signal.SIGKILL)
        self.wait(None)
        return killed_s

    def stop(self, grace_s: float = GRACE_S) -> int:
        """End it as Ctrl-C does, or kill it where that does not help; gives its exit code."""
        if self.alive:
            self.signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.child.wait(grace_s)
        self.kill()
        return self.child.returncode

    def __enter__(self) -> Process:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


class Processes(dict[str, Process]):
    """Starts children on entry, ends every one of them on exit, whatever happened between."""

    def __init__(
        self,
        commands: Mapping[str, Sequence[str]],
        log_dir: Path,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        """`commands` by the children's names; each log is `<name>.log` in `log_dir`, new."""
        super().__init__()
        self._commands = commands
        self._log_dir = log_dir
        self._environment = environment

    def __enter__(self) -> Processes:
        self._log_dir.mkdir(parents=True, exist_ok=True)
        try:
            for name, command in self._commands.items():
                log = self._log_dir / f"{name}.log"
                log.unlink(missing_ok=True)
                self[name] = Process(name, command, log, self._environment)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        with end_signals(signal.SIG_IGN):  # the end is carried through
            for child in reversed(self.values()):
                child.signal(signal.SIGTERM)  # SIGINT may be ignored from birth: `nohup`, `&`
            deadline_s = time.monotonic() + GRACE_S
            for child in self.values():
                with contextlib.suppress(subprocess.TimeoutExpired):
                    child.wait(max(0.0, deadline_s - time.monotonic()))
                child.kill()

    def check(self) -> None:
        """Raise a `ProcessError` where a child has ended."""
        for child in self.values():
            child.check()

    def wait_for_line(self, name: str, start: str, within_s: float) -> str:
        """The rest of the first line in a child's log that begins with `start`.

        Raises:
            ProcessError: a child ended, or no such line came in time.
        """

        def found() -> list[str]:
            return [line for line in self[name].log.splitlines() if line.startswith(start)]

        line, *_ = self.wait_until(found, within_s, f"{name} was not ready")
        return line.removeprefix(start).strip()

    def wait_until(
        self, found: Callable[[], Found | None], within_s: float, otherwise: str
    ) -> Found:
        """As the function of this name, while all children run; a `ProcessError` if one ends."""
        text = f"{otherwise} within {within_s:g} s; logs are in {self._log_dir}"
        return wait_until(found, within_s, text, self.check)


def handle_end_signals(handler: Any) -> dict[signal.Signals, Any]:
    """Handle SIGINT, SIGTERM and, unless nohup has it ignored, SIGHUP; gives earlier handlers."""
    ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    numbers = [signal.SIGINT, signal.SIGTERM, *([] if ignored else [signal.SIGHUP])]
    return {number: signal.signal(number, handler) for number in numbers}


@contextlib.contextmanager
def end_signals(handler: Any) -> Iterator[None]:
    """As `handle_end_signals`, inside the block."""
    before = handle_end_signals(handler)
    try:
        yield
    finally:
        for number, one_before in before.items():
            signal.signal(number, one_before)


def _die_with_parent(parent_pid: int) -> Callable[[], None] | None:
    if sys.platform != "linux":
        return None
    libc = ctypes.CDLL(None)  # not after the fork, where loading may lock up

    def arrange() -> None:
        libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent_pid:
            os._exit(1)

    return arrange


PROFILES: Final = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Where Fast DDS looks for profiles, by its older and its newer name."""
TRANSPORTS: Final = "FASTDDS_BUILTIN_TRANSPORTS"
"""Which transports Fast DDS brings along, where neither a profile nor ROS 2 sets others.

Shared memory is left out: a process that is killed leaves its ports in it, and others that wrote
to them need seconds before they reach who comes back. Over UDP they need none.
"""
RANGE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"
DOMAIN: Final = "ROS_DOMAIN_ID"
_OLDER_RANGE: Final = "ROS_LOCALHOST_ONLY"
_DOMAINS: Final = range(1, 101)
"""Domain ids that are safe on Linux go from 0 to 101; 0 is everyone's."""


def prefer_quick_discovery(environment: MutableMapping[str, str] = os.environ) -> None:
    """Use a bundled profile and UDP, unless the user has a profile; call it before `rclpy.init`.

    Who asked for this machine alone gets `dds/loopback.xml`, which keeps that promise, in place of
    a discovery range of LOCALHOST, for which ROS 2 adds shared memory whatever else is asked for.
    Other middleware, or another release of ROS 2, finds its settings untouched.
    """
    middleware = environment.get("RMW_IMPLEMENTATION") or "rmw_fastrtps_cpp"
    release = environment.get("ROS_DISTRO") or "jazzy"
    if not middleware.startswith("rmw_fastrtps") or release != "jazzy":
        return
    if any(environment.get(name) for name in PROFILES):
        return
    # the older variable wins where both are set, as in ROS 2
    older = environment.get(_OLDER_RANGE)
    alone = older == "1" if older else environment.get(RANGE) == "LOCALHOST"
    alone = alone and not environment.get(TRANSPORTS)
    path = config_path("dds/loopback.xml" if alone else "dds/quick_discovery.xml")
    for name in PROFILES:
        environment[name] = str(path)
    if alone:
        environment[RANGE] = "SYSTEM_DEFAULT"
        environment.pop(_OLDER_RANGE, None)
    else:
        environment.setdefault(TRANSPORTS, "UDPv4")


def own_graph(environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The environment of nodes that stay on this machine, in a domain of their own.

    A domain, a discovery range or a profile of Fast DDS that is set already stays.
    """
    variables = dict(environment)
    variables.setdefault(RANGE, "LOCALHOST")
    prefer_quick_discovery(variables)
    if not variables.get(DOMAIN):
        variables[DOMAIN] = str(free_domain())
    variables.setdefault("OMP_NUM_THREADS", "1")
    variables["PYTHONUNBUFFERED"] = "1"
    return variables


@functools.cache
def free_domain() -> int:
    """A ROS domain that no other process on this machine has got here, for this process's life."""
    start = os.getpid() % len(_DOMAINS)
    for domain in (*_DOMAINS[start:], *_DOMAINS[:start]):
        path = Path(tempfile.gettempdir(), f"cablesense_ros_domain_{domain}.lock")
        try:  # what is opened stays open until the process ends
            fcntl.flock(os.open(path, os.O_WRONLY | os.O_CREAT), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:  # in use, or another user's
            continue
        return domain
    raise CableSenseError(f"all ROS domains are in use; set {DOMAIN} to one that may be shared")
