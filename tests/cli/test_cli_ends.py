"""A signal ends a verb with its worker processes, and leaves no part of a file."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from gap_recordings import small_recording

from cablesense_gap.recordings.csv_file import write_csv

pytestmark = pytest.mark.slow  # processes start

COMMAND = [sys.executable, "-c", "from cablesense_ros.cli.app import main; main()"]
CODES = {signal.SIGINT: 130, signal.SIGTERM: 143}
DATASET = ("dataset", "--samples", "50000000", "--workers", "2", "--out", "out/d.parquet")


def descendants(pid: int) -> list[int]:
    """Worker processes, and those that Python starts for them."""
    children = Path(f"/proc/{pid}/task/{pid}/children")
    found = [int(child) for child in children.read_text().split()] if children.exists() else []
    return [*found, *(each for child in found for each in descendants(child))]


def until(condition, what):
    deadline_s = time.monotonic() + 60.0
    while not (found := condition()):
        assert time.monotonic() < deadline_s, what
        time.sleep(0.05)
    return found


def at_work(process: subprocess.Popen[str]) -> list[int]:
    """The resource tracker of multiprocessing and two workers that have begun to compute."""
    pids = until(lambda: descendants(process.pid)[2:] and descendants(process.pid), "workers")
    until(lambda: all(cpu_s(pid) > 1.5 for pid in pids[1:]), "workers at work")
    return pids


def cpu_s(pid: int) -> float:
    return sum(map(int, Path(f"/proc/{pid}/stat").read_text().split()[13:15])) / 100.0


def ended(process: subprocess.Popen[str], number: int, pids: list[int]) -> None:
    if number == signal.SIGTERM:
        process.send_signal(number)
    else:  # a terminal sends it to the workers as well
        os.killpg(process.pid, number)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == CODES[number], errors
    assert "Traceback" not in errors
    until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in pids), "processes that live on")


def started(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    (folder / "out").mkdir()
    return subprocess.Popen(
        [*COMMAND, *arguments],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def test_a_dataset_ends_at_once_and_leaves_nothing(tmp_path):
    with started(tmp_path, *DATASET) as process:
        pids = at_work(process)
        until(lambda: list((tmp_path / "out").iterdir()), "a part of the file")
        ended(process, signal.SIGINT, pids)
    assert not list((tmp_path / "out").iterdir())


def test_a_diagnosis_ends_at_once(tmp_path):
    write_csv(tmp_path / "r.csv", small_recording())
    verb = ("gap", "diagnose", "r.csv", "--workers", "2", "--out", "out")
    with started(tmp_path, *verb) as process:
        pids = at_work(process)
        ended(process, signal.SIGTERM, pids)
    assert not list((tmp_path / "out").iterdir())
