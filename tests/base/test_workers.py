"""Tasks done by several processes have the results and the order that one process gives them."""

import os

import pytest

from cablesense_base.errors import CableSenseError
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
