"""A progress bar for long runs, on standard error: how many are done, how fast, time left."""

from __future__ import annotations

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


class _RateColumn(ProgressColumn):
    def render(self, task: Task) -> Text:
        """The note if there is one, the rate of late, or a dash until there is one."""
        if task.fields["note"]:
            return Text(task.fields["note"])
        speed = task.finished_speed or task.speed
        rate = "–" if speed is None else f"{speed:,.3g}"
        return Text(f"{rate} {task.description}/s")


@contextmanager
def progress_bar(
    total: int, *, shown: bool, what: str = "samples"
) -> Iterator[Callable[..., None]]:
    """A bar of `total` samples, or `what` they are; nothing is drawn but if `shown` on a terminal.

    What it gives is called with how many more are done, and may be with a note (losses of an
    epoch) that stands in place of the rate.
    """
    console = Console(stderr=True)
    with Progress(
        TextColumn(what),
        BarColumn(bar_width=20),
        MofNCompleteColumn(),
        _RateColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=not (shown and console.is_terminal),
    ) as progress:
        task = progress.add_task(what, total=total, note="")

        def advance(done: int, note: str = "") -> None:
            progress.update(task, advance=done, note=note)

        yield advance
