"""Work on one course, shared among processes."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from typing import Self, TypeVar

from cablesense_gap.diagnosis.course import Course

Task = TypeVar("Task")
Result = TypeVar("Result")

_course: Course | None = None


class Crew:
    """Does tasks on a course in order, in this process or in some workers."""

    def __init__(self, course: Course, workers: int) -> None:
        self._course, self._workers = course, workers
        self._pool: Executor | None = None

    def __enter__(self) -> Self:
        """Starts the workers, each with its own course."""
        if self._workers > 1:
            self._pool = ProcessPoolExecutor(
                self._workers,
                mp_context=multiprocessing.get_context("spawn"),
                initializer=_take,
                initargs=(self._course,),
            )
        return self

    def __exit__(self, *_: object) -> None:
        """Ends them; what has not begun is dropped."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def map(
        self, work: Callable[[Course, Task], Result], tasks: Iterable[Task]
    ) -> Iterator[Result]:
        """Results in the order of the tasks."""
        if self._pool is None:
            yield from (work(self._course, task) for task in tasks)
            return
        futures = [self._pool.submit(_do, work, task) for task in tasks]
        for future in futures:
            yield future.result()


def _take(course: Course) -> None:
    global _course
    _course = course


def _do(work: Callable[[Course, Task], Result], task: Task) -> Result:
    assert _course is not None
    return work(_course, task)
