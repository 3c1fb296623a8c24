"""The `cablesense` command: gathers the verbs and turns errors into one line and an exit code.

Exit codes: 0 done; 1 something that ran has failed; 2 wrong input, with a remedy in the
message; 130 Ctrl-C, 143 SIGTERM, 129 a terminal that hung up.
"""

from __future__ import annotations

import math
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from traceback import clear_frames
from typing import Annotated, Any, NoReturn, TextIO

import typer

from cablesense_base import CableSenseError
from cablesense_base.files import OutputError
from cablesense_ros.cli.arm_file import urdf
from cablesense_ros.cli.dataset import dataset
from cablesense_ros.cli.evaluate import evaluate
from cablesense_ros.cli.gap import gap
from cablesense_ros.cli.info import info
from cablesense_ros.cli.paper import paper
from cablesense_ros.cli.runs import demo, record, replay
from cablesense_ros.cli.sensors import sensors
from cablesense_ros.cli.train import train

app = typer.Typer(
    name="cablesense",
    help="Estimates from cable tensions where a cable-driven arm is touched, "
    "in which direction and how hard.",
    epilog="Start with: cablesense demo",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
for verb in (demo, dataset, train, evaluate, info, urdf, record, replay, paper):
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


_END_S = 5.0
"""More than an end takes; a signal after it asks again."""
_END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def main() -> None:
    """Runs the command and ends the process with its exit code.

    Signals that end it leave through the `with` statements: worker processes end, and no part of
    a file stays behind.
    """
    for number in _END_SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as by nohup
            signal.signal(number, _on_end_signal)
    try:
        if sys.stdout is None or sys.stderr is None:
            raise OutputError("standard output or error is closed; send both to a file")
        out = _CheckedStream(sys.stdout, "standard output")
        err = _CheckedStream(sys.stderr, "standard error")
        with redirect_stdout(out), redirect_stderr(err):
            try:
                with _released():
                    app()
            finally:
                out.flush()
    except CableSenseError as error:
        _end(" ".join(str(error).split()), getattr(error, "exit_code", 2))
    except ModuleNotFoundError as error:
        _end(
            f"this needs the Python package {error.name}, which is not installed; in a "
            "checkout run `make setup`, or pip install '.[train,gap]'",
            2,
        )
    except KeyboardInterrupt:
        _end("interrupted", 130)


_last_end_s = -math.inf


def _on_end_signal(number: int, _: object) -> None:
    global _last_end_s
    now_s = time.monotonic()
    if now_s - _last_end_s < _END_S:  # the end is under way and must not be cut short
        return
    _last_end_s = now_s
    raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(128 + number)


@contextmanager
def _released() -> Iterator[None]:
    """An error ends the generators that its frames hold, and with them pools and part files.

    Else they would end with the interpreter, which first waits for the pools' tasks.
    """
    try:
        yield
    except BaseException as error:
        each: BaseException | None = error
        while each is not None:
            clear_frames(each.__traceback__)
            each = each.__context__
        raise


class _CheckedStream:
    """A standard stream whose failure is an error of the family.

    Left to themselves, rich and typer end the process at a closed pipe without a word.
    """

    def __init__(self, stream: TextIO, name: str) -> None:
        self._stream, self._name = stream, name

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with self._refusing():
            return self._stream.write(text)

    def flush(self) -> None:
        with self._refusing():
            self._stream.flush()

    @contextmanager
    def _refusing(self) -> Iterator[None]:
        try:
            yield
        except (OSError, UnicodeEncodeError) as error:
            why = error.strerror if isinstance(error, OSError) else error
            raise OutputError(
                f"{self._name} cannot be written ({why}); send it where there is space, or to a "
                "program that reads all of it"
            ) from error


def _end(line: str, code: int) -> NoReturn:
    """Ends the process with one line of error; what cannot be written is not tried again."""
    with suppress(OSError):
        print(f"cablesense: {line}", file=sys.stderr)
    for stream in filter(None, (sys.stdout, sys.stderr)):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    sys.exit(code)
