"""The harness of all benchmarks: options, the origin of a result, its file, process statistics.

A benchmark is a script beside this file. `parser` gives its options, among them `--write`;
`origin` gives the first entries of its result: command, time, machine and versions;
`write_result` puts the result under `results/`, whole or not at all.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from cablesense_base.errors import CableSenseError
from cablesense_base.files import write_atomically

RESULTS = Path(__file__).parent / "results"
CABLESENSE = [
    *(sys.executable, "-c"),
    "import sys; from cablesense_cli.app import main; sys.exit(main())",
]
"""The command `cablesense` in this Python, also where it is not installed."""

END_WITHIN_S = 20.0
"""A node under load may take so long to end by itself."""


def parser(doc: str | None, writes: str) -> argparse.ArgumentParser:
    """The parser of a benchmark's options, with `--write`.

    Args:
        doc: the script's docstring, whose first line describes it.
        writes: the names of the files that `--write` writes, for the help text.
    """
    made = argparse.ArgumentParser(description=(doc or "").partition("\n")[0])
    made.add_argument("--write", action="store_true", help=f"write {writes}")
    return made


def origin(command: str, libraries: Sequence[str] = ()) -> dict[str, Any]:
    """Where a result comes from: command line, time (UTC), machine, versions of `libraries`."""
    return {
        "command": command,
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": f"{platform.machine()}, {os.cpu_count()} CPUs",
        "python": platform.python_version(),
        **{name: version(name) for name in libraries},
    }


def write_result(name: str, result: dict[str, Any] | str, indent: int = 1) -> Path:
    """Write a result as JSON, or a text as it is, to `results/`; gives the path."""
    text = result if isinstance(result, str) else json.dumps(result, indent=indent) + "\n"
    path = RESULTS / name
    path.parent.mkdir(exist_ok=True)
    write_atomically(path, text, CableSenseError)
    return path


_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
_TICKS_S = os.sysconf("SC_CLK_TCK")
_USER_TICKS, _SYSTEM_TICKS = 11, 12  # in the fields after the name, which may hold spaces


def rss_mb(pid: int) -> float:
    """Memory of a process that lies in RAM, MB (10^6 bytes); NaN when it has ended."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    except (OSError, IndexError):
        return float("nan")
    return pages * _PAGE_BYTES / 1e6


def cpu_s(pid: int) -> float:
    """Processor time that a process has taken so far, s; NaN when it has ended."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return float("nan")
    fields = stat.rpartition(")")[2].split()
    return (int(fields[_USER_TICKS]) + int(fields[_SYSTEM_TICKS])) / _TICKS_S


def shared_memory_mb() -> float:
    """Content of /dev/shm, MB: Fast DDS's segments, also those of processes that were killed."""
    try:
        return sum(file.stat().st_blocks for file in Path("/dev/shm").iterdir()) * 512 / 1e6
    except OSError:
        return float("nan")
