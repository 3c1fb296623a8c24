"""The harness of all benchmarks: options, the origin of a result, its file, process statistics.

A benchmark is a script in this folder: `parser` gives its options, `publish` or `write_result` its
file under `results/`.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import resource
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # examples are imported from the checkout

from cablesense_base import CableSenseError
from cablesense_base.files import write_atomically

_CASE = re.compile(r'\{\s+"case".*?\}', re.DOTALL)
"""A case of a blind set is one line of a result."""
_NUMBERS = re.compile(r"\[[^][{}]*\]")
"""So is a list of numbers."""
RESULTS = Path(__file__).parent / "results"
CABLESENSE = [
    *(sys.executable, "-c"),
    "import sys; from cablesense_ros.cli.app import main; sys.exit(main())",
]
"""The command `cablesense` in this Python, also where it is not installed."""


def parser(doc: str | None, writes: str) -> argparse.ArgumentParser:
    """The parser of a script's options, with `--write` for the files that `writes` names."""
    made = argparse.ArgumentParser(description=(doc or "").partition("\n")[0])
    made.add_argument("--write", action="store_true", help=f"write {writes}")
    return made


def origin(*libraries: str) -> dict[str, Any]:
    """The origin of a result: command line, time (UTC), machine, versions of `libraries`.

    Without the places of files, which change no figure.
    """
    command = shlex.join([f"benchmarks/{Path(sys.argv[0]).name}", *sys.argv[1:]])
    command = re.sub(r" --folder \S+", "", command)
    return {
        "command": "python " + re.sub(r"(--data|--recordings|--out) \S+", r"\1 DIR", command),
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": f"{platform.machine()}, {os.cpu_count()} CPUs",
        "python": platform.python_version(),
        **{name: version(name) for name in libraries},
    }


def publish(
    name: str, found: Mapping[str, Any], options: argparse.Namespace, *libraries: str
) -> int:
    """Print what was found with its origin, and with `--write` write it; 1 if a bar is missed."""
    result = {**origin(*libraries), **found}
    print(json.dumps(result, indent=1))
    bars: dict[str, bool] = result.get("bars", {})
    for bar, kept in bars.items():
        print(f"{'kept  ' if kept else 'MISSED'} {bar}")
    if options.write:
        write_result(name, result)
    return int(not all(bars.values()))


def kept(path: Path, make: Callable[[], Any], until_s: float = np.inf) -> Any:
    """The content of a JSON file, which is made now if there is none.

    None where the time for new ones is over (`until_s`, of `time.time`).
    """
    if not path.exists():
        if time.time() > until_s:
            return None
        path.write_text(json.dumps(make()))
    return json.loads(path.read_text())


def write_result(name: str, result: dict[str, Any] | str) -> Path:
    """Write a result as JSON, or a text as it is, to `results/`; gives the path."""
    text = result if isinstance(result, str) else json.dumps(result, indent=1) + "\n"
    for pattern in (_CASE, _NUMBERS):
        text = pattern.sub(lambda match: " ".join(match[0].split()), text)
    path = RESULTS / name
    path.parent.mkdir(exist_ok=True)
    write_atomically(path, text, CableSenseError)
    return path


def percentiles(values: Any, names: Sequence[str], digits: int = 3) -> dict[str, float]:
    """Percentiles by name: "median", "worst", or "95 %"; none of no values."""
    if not np.size(values):
        return {}
    named = {"median": "50", "worst": "100"}
    shares = {name: float(named.get(name, name.removesuffix(" %"))) for name in names}
    return {
        name: round(float(np.percentile(values, share)), digits) for name, share in shares.items()
    }


def rss_mb(pid: int) -> float:
    """Memory of a process that lies in RAM, MB (10^6 bytes); NaN when it has ended."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    except (OSError, IndexError):
        return float("nan")
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


class Watched(NamedTuple):
    """What a command took, with all of its processes.

    Attributes:
        seconds: of the clock.
        cpu_s: of processors, in user mode: hardly more on a busy machine.
        peak_mb: of memory; pages that processes share count in each.
        printed: on standard output.
    """

    seconds: float
    cpu_s: float
    peak_mb: float
    printed: str


def run_watched(command: Sequence[str]) -> Watched:
    """Run a command, and watch it."""
    began = time.monotonic()
    cpu_before_s = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    peak_mb = 0.0
    with (
        tempfile.TemporaryFile("w+", encoding="utf-8") as output,
        subprocess.Popen(command, stdout=output) as running,
    ):
        while running.poll() is None:
            sizes_mb = [rss_mb(pid) for pid in _tree(running.pid)]
            peak_mb = max(peak_mb, float(np.nansum(sizes_mb)))
            time.sleep(0.1)
        output.seek(0)
        printed = output.read()
    if running.returncode:
        raise SystemExit(f"{command[0]} ended with {running.returncode}")
    cpu_s = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - cpu_before_s
    return Watched(time.monotonic() - began, cpu_s, peak_mb, printed)


def _tree(pid: int) -> Iterator[int]:
    """A process and all that it started, while they run."""
    with suppress(OSError):  # ended meanwhile
        tasks = [task / "children" for task in Path(f"/proc/{pid}/task").iterdir()]
        children = [int(child) for task in tasks for child in task.read_text().split()]
        yield pid
        for child in children:
            yield from _tree(child)


def cpu_s(pid: int) -> float:
    """Processor time that a process has taken, s; NaN when it has ended."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return float("nan")
    fields = stat.rpartition(")")[2].split()  # behind the name, which may hold spaces
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
