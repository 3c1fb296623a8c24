"""`cablesense train` for networks with memory: sequences in motion instead of single samples."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from cablesense_sim.arm import Arm
from cablesense_training.data.progress import sample_progress
from cablesense_training.epoch_progress import epoch_progress
from cablesense_training.errors import TrainingError
from cablesense_training.motion.fit_sequences import SequenceFitSettings
from cablesense_training.motion.motion_protocol import MotionProtocol
from cablesense_training.train_temporal import (
    TemporalReport,
    count_of_test,
    train_temporal,
    training_and_test,
)


def train_on_sequences(
    out: Path,
    network: str,
    arm: Arm,
    protocol_options: dict[str, Any],
    fit_options: dict[str, Any],
    *,
    command: str,
    as_json: bool,
) -> None:
    """Draw sequences, train, print the figures; options of None stand for the network's own.

    Raises:
        CableSenseError: an option out of range, or an arm without rest.
    """
    protocol = MotionProtocol(**_given(protocol_options))
    settings = replace(SequenceFitSettings(), **_given(fit_options))
    _require_positive(settings)
    count = protocol.sequences + count_of_test(protocol)
    with sample_progress(count, shown=not as_json, what="sequences") as advance:
        training, test = training_and_test(
            arm, protocol, settings.seed, workers=os.cpu_count() or 1, on_done=advance
        )
    with epoch_progress(settings.epochs, shown=not as_json) as on_epoch:
        report = train_temporal(
            out, network, training, test, settings, command=command, on_epoch=on_epoch
        )
    if as_json:
        print(json.dumps(plain_figures(report)))
    else:
        Console().print(_table(report, arm.identity))


def plain_figures(report: TemporalReport) -> dict[str, Any]:
    """As plain values."""
    return {
        "out": str(report.path),
        "network": report.network,
        "parameters": report.parameters,
        "bytes": report.path.stat().st_size,
        "sequences": report.sequences,
        "test_sequences": report.test_sequences,
        "best_epoch": report.history.best_epoch,
        "training_seconds": report.history.seconds,
        **asdict(report.figures),
    }


def _table(report: TemporalReport, arm_identity: str) -> Table:
    table = Table(title=f"{report.path}: {report.network}, arm {arm_identity}")
    for heading in ("", "ticks", "contact", "direction MAE", "force MAE", "false force"):
        table.add_column(heading, justify="right")
    figures = report.figures
    for name, metrics, false_n in (
        ("in motion", figures.moving, figures.false_force_moving_n),
        ("at rest", figures.rest, figures.false_force_rest_n),
        ("all", figures.every, figures.false_force_n),
    ):
        table.add_row(
            name,
            f"{metrics.samples:,}",
            f"{metrics.contact_accuracy:.2%}",
            f"{metrics.errors.direction_mae_deg:.2f} deg",
            f"{metrics.errors.magnitude_mae_n:.3f} N",
            f"{false_n:.3f} N",
        )
    return table


def _given(options: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}


def _require_positive(settings: SequenceFitSettings) -> None:
    for name in ("epochs", "batch_size", "threads"):
        if getattr(settings, name) < 1:
            raise TrainingError(f"{name} = {getattr(settings, name)}: must be at least 1")
    if not 0.0 < settings.learning_rate <= 1.0:
        raise TrainingError(f"learning_rate = {settings.learning_rate:g}: must be in (0, 1]")
