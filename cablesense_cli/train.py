"""`cablesense train`: teach a network what contacts do to the cables, as one model file.

`cablesense train` for networks with memory: sequences in motion instead of single samples.

What `cablesense train` prints when it is done.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from cablesense_cli.dataset import command_line

if TYPE_CHECKING:
    from cablesense_sim.arm import Arm
    from cablesense_training.fit_sequences import SequenceFitSettings
    from cablesense_training.train_model import TrainingReport
    from cablesense_training.train_temporal import TemporalReport


def train(
    arm: Annotated[str, typer.Option(help="A bundled arm's name, or an arm file.")] = "cdsm",
    network: Annotated[
        str,
        typer.Option(
            help="closed-form-corrected: statics and a small network, knows the pose, the most "
            "accurate. From tensions alone: scale-aware, or the paper's decoupled, "
            "shared-backbone and two-stage. Several contacts at once: "
            "multi-contact-closed-form, or the paper's multi-contact. In motion and under "
            "friction: temporal, which remembers, and its peer momentary, which does not."
        ),
    ] = "closed-form-corrected",
    data: Annotated[
        Path | None,
        typer.Option(help="Train on this file of cablesense dataset, not on fresh samples."),
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(
            help="How many fresh samples to draw; temporal: sequences of 30 s.",
            show_default="the network's own",
        ),
    ] = None,
    pose: Annotated[
        str,
        typer.Option(metavar="straight|random", help="Fresh samples: the arm straight, or not."),
    ] = "random",
    pose_range_deg: Annotated[
        float, typer.Option(help="Random poses: joint angles within plus or minus this.")
    ] = 10.0,
    force_high_n: Annotated[
        float | None,
        typer.Option(
            help="Strongest contact force, N.",
            show_default="200; 60 for several contacts, 100 in motion",
        ),
    ] = None,
    randomise: Annotated[
        str | None,
        typer.Option(
            metavar="EFFECT,…|all",
            help="Fresh samples: on arms with these effects, of other sizes and in other places.",
        ),
    ] = None,
    epochs: Annotated[
        int | None,
        typer.Option(help="At most so many epochs.", show_default="the network's own"),
    ] = None,
    batch_size: Annotated[
        int | None, typer.Option(help="Samples per step.", show_default="the network's own")
    ] = None,
    learning_rate: Annotated[
        float | None, typer.Option(help="Adam's, at the start.", show_default="the network's own")
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, help="Of samples, initial weights and their order.")
    ] = 0,
    threads: Annotated[
        int, typer.Option(help="Processor threads; another number changes the last digits.")
    ] = 2,
    out: Annotated[Path, typer.Option(help="The model file to write.")] = Path("model.onnx"),
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Train a network for an arm and write it as one ONNX file.

    Draws its own samples unless given a dataset, trains, tests on samples it has never seen, and
    writes the model with the arm and this command inside.

    Example: cablesense train --arm my_arm.yaml --out my_arm.onnx
    """
    from rich.console import Console

    from cablesense_sim.arm import open_arm
    from cablesense_training.fit import epoch_progress
    from cablesense_training.recipes import adjusted, recipe_for
    from cablesense_training.train_model import (
        draw_samples,
        read_samples,
        train_model,
    )
    from cablesense_training.train_temporal import TEMPORAL_NETWORKS

    if network in TEMPORAL_NETWORKS:
        _on_sequences(
            out,
            network,
            arm,
            {"data": data, "pose": None if pose == "random" else pose, "randomise": randomise},
            {
                "sequences": samples,
                "pose_range_deg": pose_range_deg,
                "force_high_n": force_high_n,
            },
            {
                "epochs": epochs,
                "batch_size": batch_size,
                "learning_rate": learning_rate,
                "seed": seed,
                "threads": threads,
            },
            as_json=as_json,
        )
        return
    recipe = recipe_for(network)
    settings = adjusted(
        recipe.settings,
        seed=seed,
        threads=threads,
        epochs=epochs,
        batch_size=batch_size,
        learning_rate=learning_rate,
    )
    drawn = {
        "samples": recipe.samples if samples is None else samples,
        "pose": pose,
        "pose_range_deg": pose_range_deg,
        "force_high_n": force_high_n,
        "randomise": randomise,
    }
    training = {
        "epochs": settings.epochs,
        "batch_size": settings.batch_size,
        "learning_rate": settings.learning_rate,
        "seed": seed,
        "threads": threads,
        "out": out,
    }
    source = drawn if data is None else {"data": data}
    command = command_line("train", {"arm": arm, "network": network, **source, **training})
    description = open_arm(arm)
    if data is None:
        dataset = draw_samples(description, network, drawn, seed, show_progress=not as_json)
    else:
        dataset = read_samples(data, description)
    with epoch_progress(settings.epochs, shown=not as_json) as on_epoch:
        report = train_model(out, network, dataset, settings, command=command, on_epoch=on_epoch)
    if as_json:
        typer.echo(json.dumps(report.figures()))
    else:
        for table in training_tables(report, description.identity):
            Console().print(table)


def _on_sequences(
    out: Path,
    network: str,
    arm: str,
    unfit: dict[str, Any],
    protocol_options: dict[str, Any],
    fit_options: dict[str, Any],
    *,
    as_json: bool,
) -> None:
    """Train a network with memory; refuses the options that single samples alone have."""
    from cablesense_sim.arm import open_arm
    from cablesense_training.errors import TrainingError

    for name, value in unfit.items():
        if value is not None:
            raise TrainingError(
                f"--{name.replace('_', '-')} {value}: network {network} learns from sequences in "
                "motion, which it draws itself; leave the option out"
            )
    said = {**protocol_options, "samples": protocol_options["sequences"]}
    del said["sequences"]
    command = command_line(
        "train", {"arm": arm, "network": network, **said, **fit_options, "out": out}
    )
    train_on_sequences(
        out,
        network,
        open_arm(arm),
        protocol_options,
        fit_options,
        command=command,
        as_json=as_json,
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
    from cablesense_base.progress import progress_bar
    from cablesense_training.fit import epoch_progress
    from cablesense_training.fit_sequences import SequenceFitSettings
    from cablesense_training.motion.motion_protocol import MotionProtocol
    from cablesense_training.train_temporal import (
        count_of_test,
        train_temporal,
        training_and_test,
    )

    protocol = MotionProtocol(**_given(protocol_options))
    settings = replace(SequenceFitSettings(), **_given(fit_options))
    _require_positive(settings)
    count = protocol.sequences + count_of_test(protocol)
    with progress_bar(count, shown=not as_json, what="sequences") as advance:
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
    from cablesense_training.errors import TrainingError

    for name in ("epochs", "batch_size", "threads"):
        if getattr(settings, name) < 1:
            raise TrainingError(f"{name} = {getattr(settings, name)}: must be at least 1")
    if not 0.0 < settings.learning_rate <= 1.0:
        raise TrainingError(f"learning_rate = {settings.learning_rate:g}: must be in (0, 1]")


def training_tables(report: TrainingReport, arm_identity: str) -> Iterator[Table]:
    """The figures on one page; for a single-contact network the errors by force, too."""
    figures = report.figures()
    title = f"{report.path}: {report.network}, arm {arm_identity}"
    summary = Table(title=title, show_header=False)
    summary.add_row("parameters", f"{figures['parameters']:,}")
    summary.add_row("size", f"{figures['bytes'] / 1000:,.0f} kB")
    summary.add_row("epochs (best)", f"{figures['epochs']} ({figures['best_epoch']})")
    summary.add_row("training time", f"{figures['training_seconds']:.0f} s")
    if report.single is not None:
        errors = report.single.errors
        summary.add_row("test samples", f"{report.single.samples:,}")
        summary.add_row("contact accuracy", f"{report.single.contact_accuracy:.2%}")
        summary.add_row("direction MAE", f"{errors.direction_mae_deg:.3f} deg")
        summary.add_row("magnitude MAE", f"{errors.magnitude_mae_n:.3f} N")
        summary.add_row("magnitude RMSE", f"{errors.magnitude_rmse_n:.3f} N")
        summary.add_row("95 % intervals that hold", f"{report.single.coverage95:.1%}")
    for metrics, which in ((report.multi, "all contacts"), (report.multi_firm, "from 5 N")):
        if metrics is not None:
            points = ", ".join(f"{error:.2f}" for error in metrics.magnitude_mae_n)
            summary.add_row(f"{which}: recognised", f"{metrics.recognition_accuracy:.2%}")
            summary.add_row(f"{which}: macro F1", f"{metrics.macro_f1:.4f}")
            summary.add_row(f"{which}: magnitude MAE by segment", f"{points} N")
    yield summary
    if report.single is None:
        return
    bins = Table(title="by force")
    for heading in ("force, N", "contacts", "right segment", "direction MAE", "magnitude MAE"):
        bins.add_column(heading, justify="right")
    for part in report.single.bins:
        errors = part.errors
        bins.add_row(
            f"{part.low_n:g} to {part.high_n:g}",
            f"{errors.contacts:,}",
            f"{errors.contact_accuracy:.2%}",
            f"{errors.direction_mae_deg:.3f} deg",
            f"{errors.magnitude_mae_n:.3f} N",
        )
    yield bins
