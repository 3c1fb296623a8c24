"""What verbs share: options, their refusal, and results as JSON or as tables."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from cablesense_base import CableSenseError
from cablesense_ros.cli.wording import worded

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
ColumnsOption = Annotated[
    Path | None,
    typer.Option(
        "--columns",
        metavar="MAP",
        help="A .yaml file that says what columns of other names and units mean, or which topics "
        "of a bag.",
        show_default="the names of docs/recordings.md",
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
VerboseOption = Annotated[
    bool, typer.Option("--verbose", help="Print all figures, as tables, after the summary.")
]
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


def print_notes(notes: Iterable[str], as_json: bool) -> None:
    """Print what was read of a recording and how; beside JSON, on standard error."""
    console = Console(stderr=as_json)
    for note in notes:
        console.print(note, soft_wrap=True, markup=False, highlight=False)


def print_json(content: Any) -> None:
    """Print a result for machines."""
    print(json.dumps(content, indent=2))


def print_summary(
    title: str, lines: Sequence[str], content: Mapping[str, Any], *, as_json: bool, verbose: bool
) -> None:
    """Print a result in some lines; with all figures as tables if `verbose`, or as JSON."""
    if as_json:
        print_json(content)
        return
    console = Console(soft_wrap=True, markup=False, highlight=False)
    console.print(title)
    for line in lines:
        console.print(f"  {line}")
    if verbose:
        print_result(title, content, as_json=False)
    else:
        console.print("all figures: --verbose or --json")


def print_result(title: str, content: Mapping[str, Any], as_json: bool) -> None:
    """Print plain values: as JSON, or as tables whose headings are the keys in words.

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
        column = worded(heading)
        table.add_column(column, justify="right" if heading in right else "left", overflow="fold")
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
                table.add_row(worded(str(name)), _shown(value))
        yield table
    if nested and all(isinstance(value, Mapping) for value in content.values()):
        parted = {name: _parted(value) for name, value in nested.items()}
        headings = list(dict.fromkeys(key for cells, _ in parted.values() for key in cells))
        rows = [
            (str(name), *(_shown(cells.get(key, "")) for key in headings))
            for name, (cells, _) in parted.items()
        ]
        if headings:
            yield from _side_by_side(title, ["", *headings], rows)
        nested = {f"{name}, {k}": v for name, (_, rest) in parted.items() for k, v in rest.items()}
    for name, value in nested.items():
        entries = value if isinstance(value, Mapping) else dict(enumerate(value, start=1))
        yield from _tables(f"{title}: {worded(str(name))}", entries)


_BORDER = 3
"""Characters of a table between two columns."""
_LONGEST_WORD = 24
"""Longer words of a cell are broken: paths, and lists of numbers."""


def _side_by_side(
    title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]
) -> Iterator[Table]:
    """A table of rows with a name each; several below each other where it is too wide.

    It is where a terminal would break the words of its headings.
    """
    columns = list(zip(headings, *rows, strict=True))
    widths = [_least_width(column) for column in columns]
    room = Console().width - 1 - widths[0]
    parts: list[list[int]] = [[]]
    used = 0
    for number, width in enumerate(widths[1:], start=1):
        if parts[-1] and used + width > room:
            parts.append([])
            used = 0
        parts[-1].append(number)
        used += width
    for part in parts:
        shown = [0, *part]
        chosen = [[row[number] for number in shown] for row in rows]
        yield titled_table(title, *(headings[number] for number in shown), rows=chosen)


def _least_width(column: Sequence[str]) -> int:
    """Width of a column, its heading first, in which no usual word is broken."""
    words = [word for cell in (worded(column[0]), *column[1:]) for word in cell.split()]
    longest = max(map(len, words), default=0)
    return _BORDER + min(longest, _LONGEST_WORD)


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
        return "; ".join(f"{worded(str(name))} {_shown(each)}" for name, each in value.items())
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
