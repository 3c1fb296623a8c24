"""A progress bar for training: epoch, losses, learning rate and time left, on standard error."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from cablesense_training.fit import EpochRecord


@contextmanager
def epoch_progress(epochs: int, *, shown: bool) -> Iterator[Callable[[EpochRecord], None]]:
    """A bar of `epochs` at most; call what it gives after every epoch.

    Nothing is drawn unless `shown` and standard error is a terminal.
    """
    console = Console(stderr=True)
    with Progress(
        TextColumn("epochs"),
        BarColumn(bar_width=20),
        MofNCompleteColumn(),
        TextColumn("{task.fields[losses]}"),
        TimeRemainingColumn(),
        console=console,
        disable=not (shown and console.is_terminal),
    ) as progress:
        task = progress.add_task("epochs", total=epochs, losses="")

        def advance(record: EpochRecord) -> None:
            progress.update(task, completed=record.epoch, losses=losses_line(record))

        yield advance


def losses_line(record: EpochRecord) -> str:
    """One epoch's losses in one line."""
    return (
        f"loss {record.total:.4f} (contact {record.contact:.4f}, "
        f"direction {record.direction:.4f}, magnitude {record.magnitude:.4f}), "
        f"held out {record.validation:.4f}, rate {record.learning_rate:.1e}"
    )
