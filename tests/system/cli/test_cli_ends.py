"""A signal ends a verb with its worker processes, and leaves no part of a file."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.waiting import until

pytestmark = pytest.mark.slow  # processes start

COMMAND = [sys.executable, "-c", "from cablesense_ros.cli.app import main; main()"]
DATASET = ("dataset", "--samples", "50000000", "--workers", "2", "--out", "out/d.parquet")


def descendants(pid: int) -> list[int]:
    """Worker processes, and those that Python starts for them."""
    children = Path(f"/proc/{pid}/task/{pid}/children")
    pids = [int(child) for child in children.read_text().split()] if children.exists() else []
    return [*pids, *(each for child in pids for each in descendants(child))]


def at_work(process: subprocess.Popen[str]) -> list[int]:
    """The resource tracker of multiprocessing and two workers that have begun to compute."""
    pids = until(lambda: descendants(process.pid)[2:] and descendants(process.pid), "two workers")
    until(lambda: all(cpu_s(pid) > 1.5 for pid in pids[1:]), "workers at work")
    return pids


def cpu_s(pid: int) -> float:
    return sum(map(int, Path(f"/proc/{pid}/stat").read_text().split()[13:15])) / 100.0


def test_ctrl_c_ends_a_dataset_with_its_workers_and_leaves_nothing(tmp_path):
    (tmp_path / "out").mkdir()
    with subprocess.Popen(
        [*COMMAND, *DATASET],
        cwd=tmp_path,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        pids = at_work(process)
        until(lambda: list((tmp_path / "out").iterdir()), "a part of the file")
        os.killpg(process.pid, signal.SIGINT)  # a terminal sends it to the workers as well
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 130, errors
        assert "Traceback" not in errors
        until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in pids), "the ends of all")
    assert not list((tmp_path / "out").iterdir())
