"""Tasks on a Dask cluster, as on the worker processes of a pool."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from typing import Any

from cablesense_base import CableSenseError
from cablesense_base.installation import package_version
from cablesense_base.workers import Result

PATIENCE_S = 10.0
"""How long a Dask scheduler may take to answer, and its first worker to appear."""

IN_FLIGHT_PER_WORKER = 3
"""Tasks per worker that are under way or done and not yet taken."""


def map_on_cluster(
    address: str,
    function: Callable[..., Result],
    tasks: Iterable[Any],
    *shared: Any,
    refusal: type[CableSenseError] = CableSenseError,
) -> Iterator[Result]:
    """Results of ``function(*shared, task)`` in order; every worker of the cluster is kept busy.

    Raises:
        CableSenseError: of the class `refusal`: a cluster out of reach, or one that runs another
            version of this package. Errors of the function pass through.
    """
    with _connected(address, refusal) as client:
        from distributed import KilledWorker
        from distributed.comm.core import CommClosedError

        most_pending = len(client.scheduler_info()["workers"]) * IN_FLIGHT_PER_WORKER
        pending: deque[Any] = deque()
        try:
            for task in tasks:
                pending.append(client.submit(function, *shared, task, pure=False))
                if len(pending) == most_pending:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        except (KilledWorker, CommClosedError, CancelledError) as error:
            raise _out_of_reach(address, error, refusal) from error


def _connected(address: str, refusal: type[CableSenseError]) -> Any:
    """A client of the scheduler, whose workers run the same version of this package."""
    try:
        import distributed

        client = distributed.Client(address, timeout=PATIENCE_S, set_as_default=False)
        client.wait_for_workers(1, timeout=PATIENCE_S)
        versions = client.run(package_version)
        own_version = package_version()
    except ImportError as error:
        raise refusal(
            f"{error}: a Dask cluster needs `pip install distributed` here and this package there"
        ) from error
    except (OSError, ValueError, TypeError) as error:
        raise _out_of_reach(address, error, refusal) from error
    for worker, worker_version in sorted(versions.items()):
        if worker_version != own_version:
            client.close()
            raise refusal(
                f"Dask worker {worker} runs version {worker_version} of this package and this "
                f"machine {own_version}; install the same version on both"
            )
    return client


def _out_of_reach(
    address: str, error: BaseException, refusal: type[CableSenseError]
) -> CableSenseError:
    reason = " ".join(str(error).split()) or type(error).__name__
    return refusal(
        f"no Dask cluster works at {address!r} (a scheduler is named like "
        f"tcp://127.0.0.1:8786, its workers start with: dask worker ADDRESS): {reason}"
    )
