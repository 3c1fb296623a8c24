"""What several verbs do with their options and results."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from cablesense_base.errors import CableSenseError

ArmOption = Annotated[str, typer.Option(help="Arm file: the name of a bundled one, or a path.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print as JSON.")]
DurationOption = Annotated[
    float | None, typer.Option(min=0.1, help="Seconds to record.", show_default="until Ctrl-C")
]
RecordingFile = Annotated[Path, typer.Option(help="The .mcap file to write.")]


class OptionError(CableSenseError):
    """Options that do not go together."""


def refuse_given(context: typer.Context, names: Iterable[str], why: str) -> None:
    """Refuse options that this run would ignore; a default that is spelled out is harmless.

    Args:
        context: of the command.
        names: the function's parameters that are without effect.
        why: ends the sentence "… has no effect".

    Raises:
        OptionError: one of them has another value than its default.
    """
    given = [
        parameter.opts[0] if parameter.opts[0].startswith("-") else parameter.opts[0].upper()
        for parameter in context.command.params
        if parameter.name in set(names) and context.params[parameter.name] != parameter.default
    ]
    if given:
        have = "has" if len(given) == 1 else "have"
        raise OptionError(f"{', '.join(given)} {have} no effect {why}; leave it out")


def print_json(content: Any) -> None:
    """Print a result for machines."""
    print(json.dumps(content, indent=2))


def task_bars(console: Console) -> Progress:
    """Bars of tasks with their descriptions and the time that they have taken."""
    columns = (TextColumn("{task.description:36}"), BarColumn(), TimeElapsedColumn())
    return Progress(*columns, console=console)


def titled_table(title: str, *headings: str, right: Iterable[str] = ()) -> Table:
    """A table without rows, its title and columns to the left; those in `right` to the right."""
    table = Table(
        title=title, title_justify="left", header_style="bold", show_header=bool(headings)
    )
    for heading in headings:
        table.add_column(heading, justify="right" if heading in right else "left")
    return table
