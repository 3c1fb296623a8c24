"""Generation of a dataset: in this process, on worker processes, or on a Dask cluster.

All three run the same chunks and hand them on in order, so the result does not depend on where it
was computed (on machines whose arithmetic agrees to the last bit; a mix of processor types may
differ there).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from cablesense_base.installation import package_version
from cablesense_base.workers import WorkerPool
from cablesense_sim.arm import Arm
from cablesense_training.data.chunk import generate_chunk
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.protocols import Protocol, chunk_sizes
from cablesense_training.errors import DatasetError

_MAX_WORKERS = 256
DASK_PATIENCE_S = 10.0
"""How long a Dask scheduler may take to answer, and its first worker to appear."""

_IN_FLIGHT_PER_WORKER = 3


def generate(
    arm: Arm,
    protocol: Protocol,
    seed: int,
    *,
    workers: int = 1,
    dask_scheduler: str | None = None,
) -> Iterator[Dataset]:
    """The dataset in parts, in order: the same parts for any `workers` and for a Dask cluster.

    With one worker everything happens in this process. With more, a script that calls this needs
    the usual `if __name__ == "__main__":` guard, as the processes are spawned. Few chunks are
    held at a time, so that a run of any size can be written as it comes.

    Raises:
        DatasetError: an option out of range, a sample without equilibrium, a lost worker, a
            cluster out of reach or one that runs another version of this package.
    """
    if not isinstance(seed, int) or not 0 <= seed < 2**63:
        raise DatasetError(f"seed = {seed!r}: must be a whole number from 0 to 2^63 - 1")
    if not isinstance(workers, int) or not 1 <= workers <= _MAX_WORKERS:
        raise DatasetError(
            f"workers = {workers!r}: must be a whole number from 1 to {_MAX_WORKERS}"
        )
    chunks = len(chunk_sizes(protocol.samples))
    if dask_scheduler is not None:
        return _on_dask(dask_scheduler, chunks, arm, protocol, seed)
    return _on_processes(min(workers, chunks), chunks, arm, protocol, seed)


def draw_dataset(arm: Arm, protocol: Protocol, seed: int = 0, *, workers: int = 1) -> Dataset:
    """The dataset that arm, protocol and seed determine, in memory.

    Raises:
        DatasetError: as `generate`.
    """
    return Dataset.concatenate(list(generate(arm, protocol, seed, workers=workers)))


def _on_processes(workers: int, chunks: int, *run: Any) -> Iterator[Dataset]:
    with WorkerPool(workers, *run, refusal=DatasetError) as pool:
        most_pending = workers * _IN_FLIGHT_PER_WORKER
        yield from pool.map(generate_chunk, range(chunks), most_pending=most_pending)


def _on_dask(address: str, chunks: int, *run: Any) -> Iterator[Dataset]:
    """Keep every worker busy, hand the parts on in order."""
    with _dask(address) as client:
        most_pending = _check_cluster(client, address) * _IN_FLIGHT_PER_WORKER
        pending: deque[Any] = deque()
        for chunk in range(chunks):
            pending.append(client.submit(generate_chunk, *run, chunk, pure=False))
            if len(pending) == most_pending:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()


@contextmanager
def _dask(address: str) -> Iterator[Any]:
    """A client of the cluster; its errors in this block become errors of the dataset."""
    try:
        import distributed
    except ImportError as error:
        raise DatasetError(
            "a Dask scheduler was given, but distributed is not installed: pip install distributed"
        ) from error
    try:
        client = distributed.Client(address, timeout=DASK_PATIENCE_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise DatasetError(
            f"no Dask scheduler answers at {address!r} (expected something like "
            f"tcp://127.0.0.1:8786): {_line(error)}"
        ) from error
    lost = (distributed.KilledWorker, distributed.client.FutureCancelledError, OSError)
    with client:
        try:
            yield client
        except lost as error:
            raise DatasetError(
                f"the Dask cluster at {address} lost its workers: {_line(error)}"
            ) from error


def _check_cluster(client: Any, address: str) -> int:
    """Number of workers (at least one), all of which run this version of the package."""
    try:
        client.wait_for_workers(1, timeout=DASK_PATIENCE_S)
        versions = client.run(package_version)
    except TimeoutError as error:
        raise DatasetError(
            f"the Dask scheduler at {address} has no workers; "
            f"start one with: dask worker {address}"
        ) from error
    except ModuleNotFoundError as error:
        raise DatasetError(
            f"a Dask worker at {address} lacks this package ({error}); install it on every machine"
        ) from error
    here = package_version()
    for worker, there in sorted(versions.items()):
        if there != here:
            raise DatasetError(
                f"Dask worker {worker} runs version {there} of this package and this machine "
                f"{here}; install the same version on both"
            )
    return len(versions)


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
