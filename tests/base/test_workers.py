"""Tasks done by several processes have the results and the order that one process gives them."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from cablesense_base import CableSenseError
from cablesense_base.workers import WorkerPool


class LostError(CableSenseError):
    pass


def scaled(shared: list[float], factor: float, power: int) -> tuple[float, int]:
    return factor * sum(shared) ** power, os.getpid()


def fail(shared: str, task: int) -> int:
    if task == 1:
        raise ValueError("the second task fails")
    return task


def end_process(code: int) -> None:
    os._exit(code)


@pytest.mark.slow  # processes start
@pytest.mark.parametrize(("workers", "most_pending"), [(0, None), (1, 1), (2, None), (2, 3)])
def test_results_come_in_the_order_of_the_tasks(workers, most_pending):
    factors, powers = [float(k) for k in range(12)], [1, 2] * 6
    with WorkerPool(workers, [1.0, 2.0]) as pool:
        done = list(pool.map(scaled, factors, powers, most_pending=most_pending))
    assert [value for value, _ in done] == [
        k * 3.0**power for k, power in zip(factors, powers, strict=True)
    ]
    assert (os.getpid() in {process for _, process in done}) == (workers < 2)


@pytest.mark.slow  # processes start
@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_of_a_task_is_raised_at_its_turn(workers):
    with WorkerPool(workers, "shared") as pool:
        results = pool.map(fail, range(3))
        assert next(results) == 0
        with pytest.raises(ValueError, match="the second task"):
            next(results)


@pytest.mark.slow  # processes start
def test_a_lost_process_is_reported_in_one_line():
    with (
        WorkerPool(2, refusal=LostError) as pool,
        pytest.raises(LostError, match="try fewer workers"),
    ):
        list(pool.map(end_process, range(2)))


def work(folder: str, fails: bool) -> None:
    with tempfile.TemporaryDirectory(dir=folder):
        (Path(folder) / f"{os.getpid()}.pid").touch()
        while not fails or len(list(Path(folder).glob("*.pid"))) < 2:
            time.sleep(0.05)
        raise ValueError("the task fails")


OWNER = """
import sys
from test_workers import work
from cablesense_base.workers import WorkerPool

if __name__ == "__main__":
    with WorkerPool(2, sys.argv[1]) as pool:
        list(pool.map(work, [sys.argv[2] == "fails", False]))
"""
"""Two tasks; the one waits for ever, and so does the other, or it fails."""


def started_owner(tmp_path: Path, does: str) -> subprocess.Popen[bytes]:
    (tmp_path / "owner.py").write_text(OWNER)
    path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    return subprocess.Popen(
        [sys.executable, tmp_path / "owner.py", tmp_path, does],
        env=os.environ | {"PYTHONPATH": path},
        stderr=subprocess.DEVNULL,
    )


def workers_of(folder: Path) -> list[int]:
    """Once two are at work."""
    deadline_s = time.monotonic() + 60.0
    while len(found := list(folder.glob("*.pid"))) < 2:
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    return [int(path.stem) for path in found]


def assert_gone(pids: list[int]) -> None:
    deadline_s = time.monotonic() + 20.0
    while left := [pid for pid in pids if Path(f"/proc/{pid}").exists()]:
        assert time.monotonic() < deadline_s, f"processes {left} live on"
        time.sleep(0.05)


@pytest.mark.slow  # processes start
def test_an_error_ends_the_tasks_under_way_and_their_files(tmp_path):
    with started_owner(tmp_path, "fails") as owner:
        assert owner.wait(60.0) == 1
    assert_gone(workers_of(tmp_path))
    assert not [each for each in tmp_path.iterdir() if each.is_dir()]


@pytest.mark.slow  # processes start
def test_workers_end_with_an_owner_that_is_killed(tmp_path):
    with started_owner(tmp_path, "waits") as owner:
        workers = workers_of(tmp_path)
        owner.send_signal(signal.SIGKILL)
    assert_gone(workers)
    assert not [each for each in tmp_path.iterdir() if each.is_dir()]


def large(_: str, task: int) -> bytes:
    return bytes(50_000_000 + task)


def end_in_mid_result() -> None:
    with WorkerPool(2, "") as pool:
        next(pool.map(large, [0, 1] * 20, most_pending=6))
        raise ValueError("the owner fails")


@pytest.mark.slow  # processes start
@pytest.mark.timeout(60)
def test_a_result_that_is_cut_short_holds_nothing_up():
    for _ in range(3):
        with pytest.raises(ValueError, match="the owner fails"):
            end_in_mid_result()
