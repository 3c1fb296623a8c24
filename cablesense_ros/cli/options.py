"""What verbs share: options, their refusal, progress, and results as JSON or as tables."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from cablesense_base import CableSenseError

NominalArmOption = Annotated[
    str, typer.Option(help="Nominal arm: a path, or the name of a bundled one.")
]
ModelOption = Annotated[
    Path | None,
    typer.Option(
        help="In place of --arm: MJCF or URDF of any robot with hinges and slides on a fixed "
        "base, or the folder of its diagnosis."
    ),
]
RecordingArgument = Annotated[
    Path,
    typer.Argument(
        help="A .csv or .csv.gz file, a .mcap file or a rosbag2 folder; with --model also a "
        "folder of CSV files."
    ),
]
TopicsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="NAME",
        help="The topic of a bag to read where several fit; of an arm all of its namespace. May "
        "be given several times.",
        show_default="the one that fits",
    ),
]
EffortOption = Annotated[
    list[str] | None,
    typer.Option(
        "--effort",
        metavar="[JOINT=]MEANING[:FACTOR]",
        help="With --model: what the efforts of all joints or of one are: torque, current, or "
        "torque_without_gravity. FACTOR is N·m or N by one unit of them (0.001 of mN·m); the "
        "torque constant of a current without one is fitted. May be given several times.",
        show_default="what the columns state, else torque",
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print as JSON.")]
DurationOption = Annotated[
    float | None, typer.Option(min=0.1, help="Seconds to record.", show_default="until Ctrl-C")
]
RecordingFile = Annotated[Path, typer.Option(help="The .mcap file to write.")]
ForceOption = Annotated[
    bool, typer.Option("--force", help="Replace files of the same names that exist already.")
]
WorkersOption = Annotated[int, typer.Option(min=1, max=256, help="Processes to use.")]
DaskOption = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Run on this Dask cluster instead.")
]


class OptionError(CableSenseError):
    """Options that do not go together."""


def refuse_given(context: typer.Context, names: Iterable[str], why: str) -> None:
    """Raise an `OptionError` for options that this run would ignore; a default is harmless.

    `names` are the function's parameters; `why` ends the sentence "… has no effect".
    """
    ignored = [
        parameter.opts[0] if parameter.opts[0].startswith("-") else parameter.opts[0].upper()
        for parameter in context.command.params
        if parameter.name in set(names) and _given(context.params[parameter.name], parameter)
    ]
    if ignored:
        have = "has" if len(ignored) == 1 else "have"
        raise OptionError(f"{', '.join(ignored)} {have} no effect {why}; leave it out")


def _given(value: Any, parameter: Any) -> bool:
    """Whether a value is other than the default; a list without one begins empty."""
    return value != parameter.default and value not in ([], ())


def task_bars(console: Console) -> Progress:
    """Bars of tasks with their descriptions, the time that they have taken, and the time left."""
    times = (TimeElapsedColumn(), TextColumn("about"), TimeRemainingColumn(), TextColumn("left"))
    columns = (TextColumn("{task.description:36}"), BarColumn(bar_width=20), *times)
    return Progress(*columns, console=console, speed_estimate_period=3600.0)


@contextmanager
def diagnosis_progress(
    console: Console,
) -> Iterator[tuple[Callable[[str, float], None], Callable[[str], None]]]:
    """What to call with what a diagnosis does and the share done, and with each finding."""
    with task_bars(console) as progress:
        task = progress.add_task("reading", total=1.0)

        def show(doing: str, done: float) -> None:
            progress.update(task, description=doing.replace("_", " "), completed=done)

        def warn(finding: str) -> None:
            progress.console.print(f"warning: {finding}", soft_wrap=True, markup=False)

        yield show, warn


def print_notes(notes: Iterable[str], as_json: bool) -> None:
    """Print what was read of a recording and how; beside JSON, on standard error."""
    console = Console(stderr=as_json)
    for note in notes:
        console.print(note, soft_wrap=True, markup=False, highlight=False)


def print_json(content: Any) -> None:
    """Print a result for machines."""
    print(json.dumps(content, indent=2))


def print_result(title: str, content: Mapping[str, Any], as_json: bool) -> None:
    """Print plain values: as JSON, or as tables whose headings are the keys.

    Keys carry the units. A collection of mappings becomes a table with a row for each.
    """
    if as_json:
        print_json(content)
        return
    for table in _tables(title, content):
        Console().print(table)


def titled_table(
    title: str, *headings: str, right: Iterable[str] = (), rows: Iterable[Sequence[str]] = ()
) -> Table:
    """A table, its title and columns to the left; those in `right` to the right."""
    table = Table(
        title=title, title_justify="left", header_style="bold", show_header=bool(headings)
    )
    for heading in headings:
        table.add_column(heading, justify="right" if heading in right else "left")
    for row in rows:
        table.add_row(*row)
    return table


def _tables(title: str, content: Mapping[Any, Any]) -> Iterator[Table]:
    plain, nested = _parted(content)
    if plain and all(isinstance(value, Mapping) for value in content.values()):
        plain = {}
        nested = dict(content)
    if plain:
        table = Table(title=title, title_justify="left", show_header=False)
        table.add_column(style="bold")
        table.add_column(overflow="fold")
        for name, value in plain.items():
            if value != []:
                table.add_row(str(name), _shown(value))
        yield table
    if nested and all(isinstance(value, Mapping) for value in content.values()):
        parted = {name: _parted(value) for name, value in nested.items()}
        headings = list(dict.fromkeys(key for cells, _ in parted.values() for key in cells))
        rows = [
            (str(name), *(_shown(cells.get(key, "")) for key in headings))
            for name, (cells, _) in parted.items()
        ]
        if headings:
            yield titled_table(title, "", *headings, rows=rows)
        nested = {f"{name}, {k}": v for name, (_, rest) in parted.items() for k, v in rest.items()}
    for name, value in nested.items():
        entries = value if isinstance(value, Mapping) else dict(enumerate(value, start=1))
        yield from _tables(f"{title}: {name}", entries)


def _parted(content: Mapping[Any, Any]) -> tuple[dict[Any, Any], dict[Any, Any]]:
    """The values that one line can hold, and the others."""
    plain = {name: value for name, value in content.items() if _fits_a_line(value)}
    return plain, {name: value for name, value in content.items() if name not in plain}


def _fits_a_line(value: Any) -> bool:
    within = value.values() if isinstance(value, Mapping) else value
    if isinstance(value, Mapping | list | tuple):
        return not any(isinstance(each, Mapping | list | tuple) for each in within)
    return True


_LISTED = 16
"""Numbers of a longer list are shown by its first and last."""


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_shown(each)}" for name, each in value.items())
    if isinstance(value, list | tuple):
        if len(value) > 1 and len(set(value)) == 1:
            return f"{_shown(value[0])} each"
        if len(value) > _LISTED:
            return f"{_shown(value[0])} … {_shown(value[-1])}"
        return ", ".join(map(_shown, value))
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
