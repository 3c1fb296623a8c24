"""`cablesense train`: a network learns the contacts behind cable tensions; one model file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from cablesense_cli.dataset import command_line
from cablesense_cli.options import refuse_given

if TYPE_CHECKING:
    from cablesense_training.model_training import TrainingReport


def train(
    context: typer.Context,
    arm: Annotated[str, typer.Option(help="A bundled arm's name, or an arm file.")] = "cdsm",
    network: Annotated[
        str,
        typer.Option(
            help="closed-form-corrected: statics and a small network, knows the pose, the most "
            "accurate. From tensions alone: scale-aware, or the paper's decoupled, "
            "shared-backbone and two-stage. Several contacts at once: "
            "multi-contact-closed-form, or the paper's multi-contact. In motion and under "
            "friction: temporal, which is history-dependent, and its baseline memoryless."
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
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Train a network for an arm and write it as one ONNX file.

    Draws its own samples unless given a dataset, trains, tests on samples it has never seen, and
    writes the model with the arm and this command inside.

    Example: cablesense train --arm my_arm.yaml --out my_arm.onnx
    """
    import os

    from cablesense_sim.arm import open_arm
    from cablesense_training.data.parquet import read_dataset
    from cablesense_training.fit import epoch_progress
    from cablesense_training.model_training import draw_training_data, train_model
    from cablesense_training.recipes import adjusted, recipe_for

    if data is not None:
        drawing = ("samples", "pose", "pose_range_deg", "force_high_n", "randomise")
        refuse_given(context, drawing, "with --data, which draws no samples")
    elif pose == "straight":
        refuse_given(context, ["pose_range_deg"], "with --pose straight")
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
    if recipe.learns_from == "motion":
        _refuse_sample_options(network, data, pose, randomise)
        del drawn["pose"], drawn["randomise"]
    command = command_line(
        "train",
        {
            "arm": arm,
            "network": network,
            **(drawn if data is None else {"data": data}),
            "epochs": settings.epochs,
            "batch_size": settings.batch_size,
            "learning_rate": settings.learning_rate,
            "seed": seed,
            "threads": threads,
            "out": out,
        },
    )
    description = open_arm(arm)
    if data is None:
        workers = (os.cpu_count() or 1) if recipe.learns_from == "motion" else 1
        training = draw_training_data(
            description, network, drawn, seed, workers=workers, show_progress=not as_json
        )
    else:
        training = read_dataset(data, description)
    with epoch_progress(settings.epochs, shown=not as_json) as on_epoch:
        report = train_model(out, network, training, settings, command=command, on_epoch=on_epoch)
    if as_json:
        typer.echo(json.dumps(report.as_json()))
    else:
        for table in _tables(report, description.identity):
            Console().print(table)


def _refuse_sample_options(
    network: str, data: Path | None, pose: str, randomise: str | None
) -> None:
    """Options that only samples have are refused for a network that learns from sequences."""
    from cablesense_training.errors import TrainingError

    refused = {"data": data, "pose": None if pose == "random" else pose, "randomise": randomise}
    for name, value in refused.items():
        if value is not None:
            raise TrainingError(
                f"--{name} {value}: network {network} learns from sequences in motion, which it "
                "draws itself; leave the option out"
            )


def _tables(report: TrainingReport, arm_identity: str) -> Iterator[Table]:
    """The report on one page; for single contacts the errors by force, too."""
    figures = report.as_json()
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
    if report.single is not None:
        bins = _table(
            "by force", "force, N", "contacts", "right segment", "direction MAE", "magnitude MAE"
        )
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
    if (motion := report.motion) is not None:
        table = _table(
            "by motion", "", "ticks", "contact", "direction MAE", "force MAE", "false force"
        )
        for name, single, false_n in (
            ("in motion", motion.moving, motion.false_force_moving_n),
            ("at rest", motion.rest, motion.false_force_rest_n),
            ("all", motion.every, motion.false_force_n),
        ):
            table.add_row(
                name,
                f"{single.samples:,}",
                f"{single.contact_accuracy:.2%}",
                f"{single.errors.direction_mae_deg:.2f} deg",
                f"{single.errors.magnitude_mae_n:.3f} N",
                f"{false_n:.3f} N",
            )
        yield table


def _table(title: str, *headings: str) -> Table:
    table = Table(title=title)
    for heading in headings:
        table.add_column(heading, justify="right")
    return table
