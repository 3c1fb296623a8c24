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

_IN_FLIGHT_PER_WORKER = 3


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
    try:
        import distributed

        with distributed.Client(address, timeout=PATIENCE_S, set_as_default=False) as client:
            client.wait_for_workers(1, timeout=PATIENCE_S)
            versions, here = client.run(package_version), package_version()
            for worker, there in sorted(versions.items()):
                if there != here:
                    raise refusal(
                        f"Dask worker {worker} runs version {there} of this package and this "
                        f"machine {here}; install the same version on both"
                    )
            pending: deque[Any] = deque()
            for task in tasks:
                pending.append(client.submit(function, *shared, task, pure=False))
                if len(pending) == len(versions) * _IN_FLIGHT_PER_WORKER:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
    except ImportError as error:
        raise refusal(
            f"{error}: a Dask cluster needs `pip install distributed` here and this package there"
        ) from error
    except (distributed.KilledWorker, CancelledError, OSError, ValueError, TypeError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise refusal(
            f"no Dask cluster works at {address!r} (a scheduler is named like "
            f"tcp://127.0.0.1:8786, its workers start with: dask worker ADDRESS): {reason}"
        ) from error
