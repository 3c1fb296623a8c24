"""`cablesense gap …`: a recording of the real arm against the simulated one."""

from __future__ import annotations

import typer

from cablesense_ros.cli.gap.diagnose import diagnose
from cablesense_ros.cli.gap.predict import predict
from cablesense_ros.cli.gap.protocol import protocol
from cablesense_ros.cli.gap.record import record
from cablesense_ros.cli.gap.score import score
from cablesense_ros.cli.gap.withhold import withhold

gap = typer.Typer(
    name="gap",
    help="Diagnoses the gap between a recorded arm and the simulated one: where it lies, "
    "which effect causes it, how far it shrinks once that effect is simulated.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)
for verb in (diagnose, predict, protocol, record, score, withhold):
    gap.command()(verb)
