"""`cablesense train`: teach a network what contacts do to the cables, as one model file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer


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

    from cablesense_ros.cli.training_tables import training_tables
    from cablesense_sim.arm_files import open_arm
    from cablesense_training.epoch_progress import epoch_progress
    from cablesense_training.recipes import adjusted, recipe_for
    from cablesense_training.train_model import train_command, train_model
    from cablesense_training.train_temporal import TEMPORAL_NETWORKS
    from cablesense_training.training_data import draw_samples, read_samples

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
    command = train_command({"arm": arm, "network": network, **source, **training})
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
    from cablesense_ros.cli.train_sequences import train_on_sequences
    from cablesense_sim.arm_files import open_arm
    from cablesense_training.errors import TrainingError
    from cablesense_training.train_model import train_command

    for name, value in unfit.items():
        if value is not None:
            raise TrainingError(
                f"--{name.replace('_', '-')} {value}: network {network} learns from sequences in "
                "motion, which it draws itself; leave the option out"
            )
    said = {**protocol_options, "samples": protocol_options["sequences"]}
    del said["sequences"]
    command = train_command({"arm": arm, "network": network, **said, **fit_options, "out": out})
    train_on_sequences(
        out,
        network,
        open_arm(arm),
        protocol_options,
        fit_options,
        command=command,
        as_json=as_json,
    )
