"""A pool of worker processes: the same results in the same order for any number of workers.

No worker outlives its pool. An error or an interrupt in the block around the pool terminates the
workers, which then remove the temporary files that they have open. Each worker also ends when the
owner of the pool is killed. Signals of the terminal are left to the owner.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait
from typing import Any, Self, TypeVar

from cablesense_base import CableSenseError

Result = TypeVar("Result")

GRACE_S = 3.0
"""How long a worker may take to end after SIGTERM, before it is killed."""
_TERMINATED = 128 + signal.SIGTERM

_shared: tuple[Any, ...] = ()
"""In a worker: what the tasks of its pool share."""
_begun = False
"""Whether a worker may have a first task."""


class WorkerPool:
    """Calls a function with values that all tasks share and those of one task, in order.

    With one worker everything happens in this process. With more, a script needs the usual
    `if __name__ == "__main__":` guard, as the processes are spawned. Function and values must be
    picklable, and the shared ones are sent to each worker once.
    """

    def __init__(
        self, workers: int, *shared: Any, refusal: type[CableSenseError] = CableSenseError
    ) -> None:
        """Give the pool its size; `shared` are the first arguments of every call.

        The processes start on entering it.
        """
        self.workers = workers
        self._common = shared
        self._refusal = refusal
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Self:
        if self.workers > 1:
            with _terminal_is_not_heard():  # multiprocessing starts a process for its semaphores
                self._pool = ProcessPoolExecutor(
                    self.workers,
                    mp_context=multiprocessing.get_context("spawn"),
                    initializer=_begin,
                    initargs=self._common,
                )
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Waiting tasks are dropped; after an error those under way are ended."""
        if self._pool is None:
            return
        if kind is not None:
            # Python 3.14 has this as ProcessPoolExecutor.terminate_workers
            workers = list((self._pool._processes or {}).values())
            for worker in workers:
                worker.terminate()
            for worker in workers:
                worker.join(GRACE_S)
                worker.kill()
            # or the pool would wait for the rest of a result that was cut short
            self._pool._result_queue._writer.close()  # type: ignore[attr-defined]
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
                with _terminal_is_not_heard():  # a worker may start
                    pending.append(self._pool.submit(_call, function, task))
                if len(pending) == most_pending:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        except BrokenProcessPool as error:
            raise self._refusal(
                "a worker process ended unexpectedly (often for want of memory); try fewer workers"
            ) from error


@contextmanager
def _terminal_is_not_heard() -> Iterator[None]:
    """Processes that start in the block inherit the blocked signals; here these only wait."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(*shared: Any) -> None:
    """In a worker, before its first task."""
    global _shared, _begun
    _shared = shared
    signal.signal(signal.SIGTERM, _end)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _begun = True


def _end(*_: object) -> None:
    if not _begun:  # the executor would print the exit
        os._exit(_TERMINATED)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the executor sends one more
    # Python would print and forget an exit that is raised while it collects an object
    sys.unraisablehook = lambda _: os._exit(_TERMINATED)
    raise SystemExit(_TERMINATED)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None  # this is a worker
    wait([parent.sentinel])
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(GRACE_S)
    os._exit(_TERMINATED)


def _call(function: Callable[..., Result], task: tuple[Any, ...]) -> Result:
    try:
        return function(*_shared, *task)
    except SystemExit:  # the executor would report it and take the next task
        os._exit(_TERMINATED)
