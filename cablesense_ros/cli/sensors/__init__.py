"""`cablesense sensors …`: tension sensors of a real arm taken into use."""

from __future__ import annotations

import typer

from cablesense_ros.cli.sensors.calibrate import calibrate
from cablesense_ros.cli.sensors.check import check

sensors = typer.Typer(
    name="sensors",
    help="Takes the tension sensors of a real arm into use.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)
for verb in (check, calibrate):
    sensors.command()(verb)
