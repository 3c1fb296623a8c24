"""A progress bar for long runs: samples done, rate and time left, on standard error."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text


class RateColumn(ProgressColumn):
    """Samples per second of late."""

    def render(self, task: Task) -> Text:
        """Give the rate, or a dash until there is one."""
        speed = task.finished_speed or task.speed
        return Text("– samples/s" if speed is None else f"{speed:,.0f} samples/s")


@contextmanager
def sample_progress(total: int, *, shown: bool) -> Iterator[Callable[[int], None]]:
    """A bar of `total` samples; call what it gives with the number of samples just done.

    Nothing is drawn unless `shown` and standard error is a terminal.
    """
    console = Console(stderr=True)
    with Progress(
        TextColumn("samples"),
        BarColumn(),
        MofNCompleteColumn(),
        RateColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=not (shown and console.is_terminal),
    ) as progress:
        task = progress.add_task("samples", total=total)
        yield lambda done: progress.advance(task, done)
