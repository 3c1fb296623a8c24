"""What several verbs do with their options and results."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from cablesense_base import CableSenseError

if TYPE_CHECKING:
    from cablesense_training.evaluation.metrics import ErrorMetrics

ArmOption = Annotated[str, typer.Option(help="Arm file: the name of a bundled one, or a path.")]
NominalArmOption = Annotated[
    str, typer.Option(help="Nominal arm: a path, or the name of a bundled one.")
]
RecordingArgument = Annotated[
    Path, typer.Argument(help="A .csv file, a .mcap file or a rosbag2 folder.")
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
PoseOption = Annotated[
    str, typer.Option(metavar="straight|random", help="The arm straight, or at random poses.")
]
PoseRangeOption = Annotated[
    float, typer.Option(help="Random poses: joint angles within plus or minus this.")
]
RandomiseOption = Annotated[
    str | None,
    typer.Option(
        metavar="EFFECT,…|all",
        help="Draw samples on arms with these effects, of other sizes and in other places; "
        "cablesense info --effects lists them.",
    ),
]


ERRORS = ("contact", "direction MAE", "force MAE", "force RMSE", "95 % holds")
"""Headings of errors; `error_cells` has what stands below them."""


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


def error_cells(errors: ErrorMetrics) -> tuple[str, ...]:
    """The errors of single contacts as every verb prints them."""
    return (
        f"{errors.contact_accuracy:.2%}",
        f"{errors.direction_mae_deg:.3f}°",
        f"{errors.magnitude_mae_n:.3f} N",
        f"{errors.magnitude_rmse_n:.3f} N",
        f"{errors.magnitude_coverage95:.1%}",
    )


def print_json(content: Any) -> None:
    """Print a result for machines."""
    print(json.dumps(content, indent=2))


def task_bars(console: Console) -> Progress:
    """Bars of tasks with their descriptions and the time that they have taken."""
    columns = (TextColumn("{task.description:36}"), BarColumn(), TimeElapsedColumn())
    return Progress(*columns, console=console)


class DiagnosisProgress(NamedTuple):
    """What a diagnosis calls: with what it does and the share done, and with each finding."""

    show: Callable[[str, float], None]
    warn: Callable[[str], None]


@contextmanager
def diagnosis_progress(console: Console) -> Iterator[DiagnosisProgress]:
    """A bar for a diagnosis; findings are printed above it."""
    with task_bars(console) as progress:
        task = progress.add_task("reading", total=1.0)

        def show(doing: str, done: float) -> None:
            progress.update(task, description=doing.replace("_", " "), completed=done)

        def warn(finding: str) -> None:
            progress.console.print(f"warning: {finding}", soft_wrap=True, markup=False)

        yield DiagnosisProgress(show, warn)


def command_line(verb: str, options: Mapping[str, Any]) -> str:
    """The command that makes a file again, from the verb's options by their Python names.

    Options left to their default of None are left out. A folder outside the present one is left
    out of the output's name, as it means nothing elsewhere.
    """
    parts = ["cablesense", verb]
    for name, value in options.items():
        option = name.replace("_", "-")
        if isinstance(value, bool):
            parts.append(f"--{option}" if value else f"--no-{option}")
        elif name == "out" and Path(value).is_absolute():
            parts += [f"--{option}", Path(value).name]
        elif value is not None:
            parts += [f"--{option}", f"{value}"]
    return shlex.join(parts)


def titled_table(
    title: str,
    *headings: str,
    right: Iterable[str] = (),
    rows: Iterable[Sequence[str]] = (),
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
