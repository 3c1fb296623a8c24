"""The `cablesense` command: gathers the verbs and turns errors into one line and an exit code.

Exit codes: 0 done; 1 something that ran has failed; 2 wrong input, with a remedy in the
message; 130 Ctrl-C.
"""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from cablesense_base.errors import CableSenseError
from cablesense_cli.dataset import dataset
from cablesense_cli.evaluate import evaluate
from cablesense_cli.gap import gap
from cablesense_cli.info import info
from cablesense_cli.paper import paper
from cablesense_cli.runs import demo, record, replay
from cablesense_cli.sensors import sensors
from cablesense_cli.train import train

app = typer.Typer(
    name="cablesense",
    help="Estimates from cable tensions where a cable-driven arm is touched, "
    "in which direction and how hard.",
    epilog="Start with: cablesense demo",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
for verb in (demo, dataset, train, evaluate, info, record, replay, paper):
    app.command()(verb)
app.add_typer(gap)
app.add_typer(sensors)


def _show_version(wanted: bool) -> None:
    if wanted:
        from cablesense_base.installation import package_version

        print(f"cablesense {package_version()}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Options before the verb."""


def main() -> None:
    """Runs the command and ends the process with its exit code."""
    try:
        app()
    except CableSenseError as error:
        print(f"cablesense: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(getattr(error, "exit_code", 2))
    except ModuleNotFoundError as error:
        print(
            f"cablesense: this needs the Python package {error.name}, which is not installed; in "
            "a checkout run `make setup`, elsewhere pip install 'cablesense_ros[train,gap]'",
            file=sys.stderr,
        )
        sys.exit(2)
    except KeyboardInterrupt:
        print("cablesense: interrupted", file=sys.stderr)
        sys.exit(130)
