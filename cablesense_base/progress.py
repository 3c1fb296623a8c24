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
    """Samples, or whatever they are, per second of late."""

    def __init__(self, what: str) -> None:
        super().__init__()
        self._what = what

    def render(self, task: Task) -> Text:
        """Give the rate, or a dash until there is one."""
        speed = task.finished_speed or task.speed
        return Text(f"– {self._what}/s" if speed is None else f"{speed:,.3g} {self._what}/s")


@contextmanager
def sample_progress(
    total: int, *, shown: bool, what: str = "samples"
) -> Iterator[Callable[[int], None]]:
    """A bar of `total` samples, or `what` they are; tell what it gives how many were just done.

    Nothing is drawn unless `shown` and standard error is a terminal.
    """
    console = Console(stderr=True)
    with Progress(
        TextColumn(what),
        BarColumn(),
        MofNCompleteColumn(),
        RateColumn(what),
        TimeRemainingColumn(),
        console=console,
        disable=not (shown and console.is_terminal),
    ) as progress:
        task = progress.add_task(what, total=total)
        yield lambda done: progress.advance(task, done)
