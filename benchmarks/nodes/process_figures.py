"""Memory and processor time of a process, from /proc (Linux)."""

from __future__ import annotations

import os
from pathlib import Path

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


def shared_memory_mb() -> float:
    """What lies in /dev/shm, MB: Fast DDS's segments, also those of processes that were killed."""
    try:
        return sum(file.stat().st_blocks for file in Path("/dev/shm").iterdir()) * 512 / 1e6
    except OSError:
        return float("nan")


def cpu_s(pid: int) -> float:
    """Processor time that a process has taken so far, s; NaN when it has ended."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return float("nan")
    fields = stat.rpartition(")")[2].split()
    return (int(fields[_USER_TICKS]) + int(fields[_SYSTEM_TICKS])) / _TICKS_S
