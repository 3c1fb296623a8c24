"""Progress of long runs, for people who wait: bars, stages, and what is being done.

All of it goes to standard error, and bars are drawn only where that is a terminal. Results, as
text or as JSON, go to standard output; so whether JSON is asked for changes no progress.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column

_BAR_WIDTH = 20
_DOING_LETTERS = 48
_PACE_S = 3600.0
"""The time left follows from the pace over this long: tasks are slow and uneven."""


def error_console() -> Console:
    """The console on which progress is shown: standard error."""
    return Console(stderr=True)


@contextmanager
def progress_bar(
    total: int, *, shown: bool = True, what: str = "samples", console: Console | None = None
) -> Iterator[Callable[..., None]]:
    """A bar of `total` samples, or `what` they are; nothing is drawn but if `shown` on a terminal.

    The function that it yields takes the number done since the last call, and optionally a note
    such as the losses of an epoch.
    """
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=_BAR_WIDTH),
        MofNCompleteColumn(),
        TextColumn("{task.fields[note]}"),
        TimeRemainingColumn(),
    )
    with _drawn(*columns, console=console, shown=shown) as progress:
        task = progress.add_task(what, total=total, note="")

        def advance(done: int, note: str = "") -> None:
            progress.update(task, advance=done, note=note)

        yield advance


class TaskBars:
    """Bars of tasks, one below the other, each with the time that it has taken and has left."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def begin(self, what: str) -> Callable[[float], None]:
        """A bar of one task more; the function takes the share of it that is done, 0 to 1."""
        task = self._progress.add_task(what, total=1.0)

        def show(done: float) -> None:
            self._progress.update(task, completed=done)

        return show


@contextmanager
def task_bars(*, console: Console | None = None) -> Iterator[TaskBars]:
    """Bars of tasks, drawn while the context lasts."""
    columns = (
        TextColumn("{task.description:36}"),
        BarColumn(bar_width=_BAR_WIDTH),
        TimeElapsedColumn(),
        TextColumn("about"),
        TimeRemainingColumn(),
        TextColumn("left"),
    )
    with _drawn(*columns, console=console) as progress:
        yield TaskBars(progress)


class StagedProgress:
    """Where a run of several stages is: a bar for each, warnings, and the time of the whole.

    How much a stage will do is open, so no bar states a time that is left; the time of all is
    announced once, before the first stage.
    """

    def __init__(self, progress: Progress, stages: Sequence[tuple[str, float]]) -> None:
        self._progress = progress
        self._stages = stages
        self._stage = -1
        self._task = progress.add_task("reading", total=None)

    def show(self, doing: str, done: float) -> None:
        """Take the present step, and the share of the whole that is done."""
        if done <= 0.0 and self._stage < 0:  # what comes before the stages
            self._progress.update(self._task, description=_one_line(doing))
            return
        stage = next(k for k, (_, end) in enumerate(self._stages) if done < end or end == 1.0)
        name, end = self._stages[stage]
        if stage != self._stage:
            self._progress.update(self._task, total=1.0, completed=1.0)
            self._progress.stop_task(self._task)
            self._task = self._progress.add_task(name, total=1.0)
            self._stage = stage
        begin = self._stages[stage - 1][1] if stage else 0.0
        share = (done - begin) / (end - begin)
        self._progress.update(
            self._task, description=_one_line(f"{name}: {doing}"), completed=min(share, 1.0)
        )

    def warn(self, finding: str) -> None:
        """Take a finding of the recording's checks."""
        self._progress.console.print(f"warning: {finding}", soft_wrap=True, markup=False)

    def announce(self, seconds: float) -> None:
        """Take the time that the whole will take."""
        line = f"This takes about {duration_text(seconds)}."
        self._progress.console.print(line, highlight=False)


@contextmanager
def staged_progress(
    stages: Sequence[tuple[str, float]], *, console: Console | None = None
) -> Iterator[StagedProgress]:
    """The progress of a run of stages, drawn while the context lasts.

    Each stage has a name, and the share of the whole at which it ends; the last ends at 1.
    """
    columns = (
        TextColumn("{task.description}", table_column=Column(width=_DOING_LETTERS)),
        BarColumn(bar_width=_BAR_WIDTH),
        TimeElapsedColumn(),
    )
    with _drawn(*columns, console=console) as progress:
        yield StagedProgress(progress, stages)


@contextmanager
def status(doing: str, *, console: Console | None = None) -> Iterator[Callable[[str], None]]:
    """What is being done, where its end is open; the function takes what is done next."""
    console = console or error_console()
    with console.status(doing) as line:
        yield line.update


def duration_text(seconds: float) -> str:
    """`20 s`, `4 min`: a time that is known to a factor."""
    if seconds < 100.0:
        return f"{max(10.0 * round(seconds / 10.0), 10.0):.0f} s"
    return f"{round(seconds / 60.0)} min"


def _drawn(*columns: ProgressColumn, console: Console | None, shown: bool = True) -> Progress:
    """Bars with these columns, on a terminal alone.

    While they are drawn, what is printed to standard output comes above them; where that is a
    file, it goes there.
    """
    console = console or error_console()
    return Progress(
        *columns,
        console=console,
        redirect_stdout=sys.stdout.isatty(),
        speed_estimate_period=_PACE_S,
        disable=not (shown and console.is_terminal),
    )


def _one_line(doing: str) -> str:
    text = doing.replace("_", " ")
    return text if len(text) <= _DOING_LETTERS else f"{text[: _DOING_LETTERS - 1]}…"
