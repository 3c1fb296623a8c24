"""`cablesense sensors …`: tension sensors of a real arm taken into use."""

from __future__ import annotations

import typer

from cablesense_ros.cli.sensors.calibrate import calibrate

sensors = typer.Typer(
    name="sensors",
    help="Takes the tension sensors of a real arm into use.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)


@sensors.callback()
def options() -> None:
    """Takes the tension sensors of a real arm into use."""


for verb in (calibrate,):
    sensors.command()(verb)
