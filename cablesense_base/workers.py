"""A pool of worker processes: the same results in the same order for any number of workers."""

from __future__ import annotations

import multiprocessing
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Self, TypeVar

from cablesense_base.errors import CableSenseError

Result = TypeVar("Result")

_shared: tuple[Any, ...] = ()
"""In a worker: what the tasks of its pool share."""


class WorkerPool:
    """Calls a function with values that all tasks share and those of one task, in order.

    With one worker everything happens in this process. With more, a script needs the usual
    `if __name__ == "__main__":` guard, as the processes are spawned; function and values must be
    picklable, and the shared ones are sent to each worker once.
    """

    def __init__(
        self, workers: int, *shared: Any, refusal: type[CableSenseError] = CableSenseError
    ) -> None:
        """Give the pool its size; `shared` are the first arguments of every call.

        The processes start on entering it.
        """
        self._workers, self._common, self._refusal = workers, shared, refusal
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Self:
        if self._workers > 1:
            self._pool = ProcessPoolExecutor(
                self._workers,
                mp_context=multiprocessing.get_context("spawn"),
                initializer=_share,
                initargs=self._common,
            )
        return self

    def __exit__(self, *_: object) -> None:
        """Tasks that have not begun are dropped."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def map(
        self,
        function: Callable[..., Result],
        *values: Iterable[Any],
        most_pending: int | None = None,
    ) -> Iterator[Result]:
        """Results of ``function(*shared, *task)`` for the tasks that ``zip(*values)`` gives.

        `most_pending` tasks may be under way or done and not yet taken; all if None.

        Raises:
            CableSenseError: of the class `refusal`: a worker process was lost. Errors of the
                function pass through.
        """
        tasks = zip(*values, strict=True)
        if self._pool is None:
            yield from (function(*self._common, *task) for task in tasks)
            return
        pending: deque[Future[Result]] = deque()
        try:
            for task in tasks:
                pending.append(self._pool.submit(_call, function, task))
                if len(pending) == most_pending:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        except BrokenProcessPool as error:
            raise self._refusal(
                "a worker process ended unexpectedly (often for want of memory); try fewer workers"
            ) from error


def _share(*shared: Any) -> None:
    global _shared
    _shared = shared


def _call(function: Callable[..., Result], task: tuple[Any, ...]) -> Result:
    return function(*_shared, *task)
