"""The `cablesense` command: gathers the verbs and turns errors into one line and an exit code.

Exit codes: 0 done; 1 something that ran has failed; 2 wrong input, with a remedy in the
message; 130 Ctrl-C, 143 SIGTERM, 129 a terminal that hung up.
"""

from __future__ import annotations

import gc
import io
import signal
import sys
from typing import Annotated

import typer

from cablesense_base import CableSenseError
from cablesense_base.installation import missing_package_line
from cablesense_ros.cli.calibrate import calibrate
from cablesense_ros.cli.estimate import estimate
from cablesense_ros.cli.evaluate import evaluate
from cablesense_ros.cli.export import export
from cablesense_ros.cli.gap import gap
from cablesense_ros.cli.info import info, urdf
from cablesense_ros.cli.machine import machine
from cablesense_ros.cli.picture import picture
from cablesense_ros.cli.runs import demo, record, replay
from cablesense_ros.cli.sensors import sensors
from cablesense_ros.cli.train import dataset, train
from cablesense_ros.processes import handle_end_signals

app = typer.Typer(
    name="cablesense",
    help="Estimates from cable tensions where a cable-driven arm is touched, "
    "in which direction and how hard.",
    epilog="Start with: cablesense demo",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
_VERBS = (
    *(demo, machine, export, estimate, picture, info, urdf, calibrate, record, replay),
    *(dataset, train, evaluate),
)
for verb in _VERBS:
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
    """Runs `cablesense`."""
    run_app(app, "cablesense")


def run_app(command: typer.Typer, name: str) -> None:
    """Runs a command of this name and ends the process with its exit code.

    A signal leaves through the `with` statements: workers end, and no part of a file stays.
    """
    handle_end_signals(_on_end_signal)
    if isinstance(sys.stdout, io.TextIOWrapper):  # a terminal may lack letters, or a frame's lines
        sys.stdout.reconfigure(errors="replace")
    line, code = _run(command)
    # generators that frames of the error held end here, and with them pools and part files
    gc.collect()
    if line:
        print(f"{name}: {' '.join(line.split())}", file=sys.stderr)
    sys.exit(code)


def _run(command: typer.Typer) -> tuple[str, int]:
    """Runs the command; gives the line for standard error, and the exit code."""
    try:
        command()
    except CableSenseError as error:
        return str(error), getattr(error, "exit_code", 2)
    except ModuleNotFoundError as error:
        return missing_package_line(error), 2
    except OSError as error:
        return str(error), 2
    except SystemExit as end:
        return "", end.code if isinstance(end.code, int) else 0
    except KeyboardInterrupt:
        return "interrupted", 130
    return "", 0


def _on_end_signal(number: int, _: object) -> None:
    handle_end_signals(signal.SIG_IGN)  # the end is under way and must not be cut short
    raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(128 + number)


if __name__ == "__main__":
    main()
