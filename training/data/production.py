"""From options to a file: generate, write as it comes, count, show progress."""

import shlex
from collections.abc import Iterator
from pathlib import Path

from cablesense_sim.arm import Arm
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import generate
from cablesense_training.data.progress import sample_progress
from cablesense_training.data.protocols import Protocol
from cablesense_training.data.summary import Summary, combine, summarise
from cablesense_training.data.writing import write_parts


def produce_dataset(
    path: str | Path,
    arm: Arm,
    protocol: Protocol,
    seed: int,
    *,
    command: str,
    workers: int = 1,
    dask_scheduler: str | None = None,
    show_progress: bool = False,
) -> Summary:
    """Write the dataset that arm, protocol and seed determine, and say what it holds.

    Raises:
        DatasetError: as `generate` and `write_parts`; nothing is written then.
    """
    parts = generate(arm, protocol, seed, workers=workers, dask_scheduler=dask_scheduler)
    summaries: list[Summary] = []
    with sample_progress(protocol.samples, shown=show_progress) as advance:

        def watched() -> Iterator[Dataset]:
            for part in parts:
                yield part
                summaries.append(summarise(part))
                advance(len(part))

        write_parts(path, watched(), arm, protocol, seed, command)
    return combine(summaries)


def dataset_command(arm: str, protocol: Protocol, seed: int) -> str:
    """The command that makes the dataset; what cannot change a byte of it is left out.

    Every option of a protocol is an option of the command, with dashes for underscores.
    """
    words = ["cablesense", "dataset", "--arm", arm]
    for name, value in protocol.options().items():
        option = "protocol" if name == "kind" else name.replace("_", "-")
        if isinstance(value, bool):
            words.append(f"--{option}" if value else f"--no-{option}")
        elif value is not None:
            words += [f"--{option}", f"{value}"]
    return shlex.join([*words, "--seed", f"{seed}"])
