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
from tests.helpers.checkout import CHECKOUT
from tests.helpers.waiting import until


class LostError(CableSenseError):
    pass


def scaled(shared: list[float], factor: float, power: int) -> tuple[float, int]:
    return factor * sum(shared) ** power, os.getpid()


@pytest.mark.slow  # processes start
@pytest.mark.parametrize(("workers", "most_pending"), [(1, None), (2, 3)])
def test_results_come_in_the_order_of_the_tasks(workers, most_pending):
    factors = [float(k) for k in range(12)]
    powers = [1, 2] * 6
    with WorkerPool(workers, [1.0, 2.0]) as pool:
        done = list(pool.map(scaled, factors, powers, most_pending=most_pending))
    assert [value for value, _ in done] == [
        k * 3.0**power for k, power in zip(factors, powers, strict=True)
    ]
    assert (os.getpid() in {process for _, process in done}) == (workers < 2)


@pytest.mark.slow  # processes start
def test_a_lost_process_is_reported_in_one_line():
    with (
        WorkerPool(2, refusal=LostError) as pool,
        pytest.raises(LostError, match="try fewer workers"),
    ):
        list(pool.map(os._exit, range(2)))


def work(folder: str, fails: bool) -> None:
    with tempfile.TemporaryDirectory(dir=folder):
        (Path(folder) / f"{os.getpid()}.pid").touch()
        while not fails or len(list(Path(folder).glob("*.pid"))) < 2:
            time.sleep(0.05)
        raise ValueError("the task fails")


OWNER = """
import sys
from tests.unit.base.test_workers import work
from cablesense_base.workers import WorkerPool

if __name__ == "__main__":
    with WorkerPool(2, sys.argv[1]) as pool:
        list(pool.map(work, [sys.argv[2] == "fails", False]))
"""
"""Two tasks; the one waits for ever, and so does the other, or it fails."""


@pytest.mark.slow  # processes start
@pytest.mark.parametrize("does", ["fails", "waits"])
def test_workers_and_their_files_end_with_a_task_that_fails_or_an_owner_that_is_killed(
    tmp_path, does
):
    (tmp_path / "owner.py").write_text(OWNER)
    path = os.pathsep.join([str(CHECKOUT), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, tmp_path / "owner.py", tmp_path, does]
    environment = os.environ | {"PYTHONPATH": path}
    with subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL) as owner:
        until(lambda: len(list(tmp_path.glob("*.pid"))) == 2, "two workers at work")
        if does == "waits":
            owner.kill()
        assert owner.wait(60.0) == (1 if does == "fails" else -signal.SIGKILL)
    processes = [Path(f"/proc/{path.stem}") for path in tmp_path.glob("*.pid")]
    until(lambda: not any(process.exists() for process in processes), "the end of the workers")
    assert not [each for each in tmp_path.iterdir() if each.is_dir()]


def large(_: str, task: int) -> bytes:
    return bytes(20_000_000 + task)


def end_in_mid_result() -> None:
    with WorkerPool(2, "") as pool:
        next(pool.map(large, [0, 1] * 20, most_pending=6))
        raise ValueError("the owner fails")


@pytest.mark.slow  # processes start
@pytest.mark.timeout(60)
def test_a_result_that_is_cut_short_holds_nothing_up():
    with pytest.raises(ValueError, match="the owner fails"):
        end_in_mid_result()
