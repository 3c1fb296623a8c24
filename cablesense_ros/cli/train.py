"""`cablesense train`: a network learns the contacts behind cable tensions; one model file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from cablesense_base.files import output_file
from cablesense_base.progress import progress_bar
from cablesense_ros.cli.options import (
    ERRORS,
    ArmOption,
    ForceOption,
    JsonOption,
    PoseOption,
    PoseRangeOption,
    RandomiseOption,
    command_line,
    error_cells,
    refuse_given,
    titled_table,
)

if TYPE_CHECKING:
    from cablesense_training.model_training import TrainingReport


def train(
    context: typer.Context,
    arm: ArmOption = "cdsm",
    network: Annotated[
        str,
        typer.Option(
            help="closed-form-corrected: statics and a small network, knows the pose, the most "
            "accurate; closed-form: statics alone. From tensions alone: scale-aware, or the "
            "paper's decoupled, shared-backbone and two-stage. Several contacts at once: "
            "multi-contact-closed-form, or the paper's multi-contact. In motion and under "
            "friction: temporal, which is history-dependent. For an arm file with friction, "
            "creep, backlash or lagging sensors whose numbers are known: history-simulated."
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
    pose: PoseOption = "random",
    pose_range_deg: PoseRangeOption = 10.0,
    force_high_n: Annotated[
        float | None,
        typer.Option(
            help="Strongest contact force, N.",
            show_default="200; 60 for several contacts, 100 in motion; less on a weak arm",
        ),
    ] = None,
    randomise: RandomiseOption = None,
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
    force: ForceOption = False,
    json_output: JsonOption = False,
) -> None:
    """Train a network for an arm and write it as one ONNX file.

    Draws its own samples unless given a dataset, trains, tests on samples it has never seen, and
    writes the model with the arm and this command inside, and with how far readings of a healthy
    arm at rest may be from its estimates.

    Example: cablesense train --arm my_arm.yaml --out my_arm.onnx
    """
    import os

    from cablesense_online.misfit_limit import put_simulated_limit
    from cablesense_sim.arm import find_arm, load_arm
    from cablesense_training.data.parquet import read_dataset
    from cablesense_training.fit import EpochRecord
    from cablesense_training.inference.metadata import HISTORY_SIMULATED
    from cablesense_training.model_training import (
        draw_training_data,
        train_model,
        widened_by_history,
    )
    from cablesense_training.recipes import adjusted, recipe_for

    if data is not None:
        drawing = ("samples", "pose", "pose_range_deg", "force_high_n", "randomise")
        refuse_given(context, drawing, "with --data, which draws no samples")
    elif pose == "straight":
        refuse_given(context, ["pose_range_deg"], "with --pose straight")
    recipe = recipe_for(network)
    in_motion = recipe.learns_from == "motion"
    chosen = {"epochs": epochs, "batch_size": batch_size, "learning_rate": learning_rate}
    settings = adjusted(recipe.settings, seed=seed, threads=threads, **chosen)
    drawn = {
        "samples": recipe.samples if samples is None else samples,
        "pose": pose,
        "pose_range_deg": pose_range_deg,
        "force_high_n": force_high_n,
        "randomise": randomise,
    }
    if in_motion:
        why = f"with network {network}, which learns from sequences in motion that it draws itself"
        refuse_given(context, ("data", "pose", "randomise"), why)
        del drawn["pose"], drawn["randomise"]
    command = {"arm": arm, "network": network, **(drawn if data is None else {"data": data})}
    command |= {name: getattr(settings, name) for name in chosen}
    command |= {"seed": seed, "threads": threads, "out": out}
    arm_file = find_arm(arm)
    output_file(out, force=force, inputs=(arm_file, data))
    description = load_arm(arm_file)
    if data is None:
        workers = (os.cpu_count() or 1) if in_motion else 1
        training = draw_training_data(
            description, network, drawn, seed, workers=workers, show_progress=not json_output
        )
    else:
        training = read_dataset(data, description)
    after = (
        widened_by_history(description, seed) if network == HISTORY_SIMULATED else lambda _: None
    )
    with progress_bar(settings.epochs, shown=not json_output, what="epochs") as advance:

        def on_epoch(record: EpochRecord) -> None:
            parts = ", ".join(
                f"{part} {getattr(record, part):.4f}"
                for part in ("contact", "direction", "magnitude")
            )
            advance(
                1,
                f"loss {record.total:.4f} ({parts}), held out {record.validation:.4f}, "
                f"rate {record.learning_rate:.1e}",
            )

        report = train_model(
            out,
            network,
            training,
            settings,
            command=command_line("train", command),
            on_epoch=on_epoch,
            on_trained=after,
        )
    if report.single is not None:
        put_simulated_limit(out)
    if json_output:
        typer.echo(json.dumps(report.as_json()))
    else:
        for table in _tables(report, description.identity):
            Console().print(table)


def _tables(report: TrainingReport, arm_identity: str) -> Iterator[Table]:
    """The report on one page; for single contacts the errors by force, too."""
    metrics = report.as_json()
    rows = [
        ("parameters", f"{report.parameters:,}"),
        ("size", f"{metrics['bytes'] / 1000:,.0f} kB"),
        ("epochs (best)", f"{metrics['epochs']} ({report.history.best_epoch})"),
        ("training time", f"{report.history.seconds:.0f} s"),
    ]
    if (single := report.single) is not None:
        rows += [
            ("test samples", f"{single.samples:,}"),
            (ERRORS[0], f"{single.contact_accuracy:.2%}"),
            *zip(ERRORS[1:], error_cells(single.errors)[1:], strict=True),
        ]
    for multi, which in ((report.multi, "all contacts"), (report.multi_firm, "from 5 N")):
        if multi is not None:
            by_segment = ", ".join(f"{error:.2f}" for error in multi.magnitude_mae_n)
            rows += [
                (f"{which}: recognised", f"{multi.recognition_accuracy:.2%}"),
                (f"{which}: macro F1", f"{multi.macro_f1:.4f}"),
                (f"{which}: force MAE by segment", f"{by_segment} N"),
            ]
    yield titled_table(f"{report.path}: {report.network}, arm {arm_identity}", rows=rows)
    if single is not None:
        headings = ("", "rows", *ERRORS)
        bins = [
            (
                f"{part.low_n:g} to {part.high_n:g} N",
                f"{part.errors.contacts:,}",
                *error_cells(part.errors),
            )
            for part in single.bins
            if part.errors.contacts
        ]
        yield titled_table("by force", *headings, right=headings, rows=bins)
    if (motion := report.motion) is not None:
        columns = ("", "ticks", "contact", "direction MAE", "force MAE", "false force")
        ticks = [
            (
                name,
                f"{part.samples:,}",
                f"{part.contact_accuracy:.2%}",
                f"{part.errors.direction_mae_deg:.3f}°",
                f"{part.errors.magnitude_mae_n:.3f} N",
                f"{false_n:.3f} N",
            )
            for name, part, false_n in (
                ("in motion", motion.moving, motion.false_force_moving_n),
                ("at rest", motion.rest, motion.false_force_rest_n),
                ("all", motion.every, motion.false_force_n),
            )
        ]
        yield titled_table("by motion", *columns, right=columns, rows=ticks)
