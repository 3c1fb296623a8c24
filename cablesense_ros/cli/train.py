"""`cablesense dataset` draws contacts and their tensions; `train` makes a model file of them."""

from __future__ import annotations

import shlex
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from cablesense_base.files import output_file
from cablesense_base.progress import progress_bar
from cablesense_ros.cli.options import (
    DaskOption,
    ForceOption,
    JsonOption,
    VerboseOption,
    print_result,
    print_summary,
    refuse_given,
)
from cablesense_ros.cli.summaries import training_lines

ArmOption = Annotated[str, typer.Option(help="Arm file: the name of a bundled one, or a path.")]
PoseOption = Annotated[
    str, typer.Option(metavar="straight|random", help="The arm straight, or at random poses.")
]
PoseRangeOption = Annotated[
    float | None,
    typer.Option(
        help="Random poses: joint angles within plus or minus this.",
        show_default="10, or less on an arm that does not hold itself there",
    ),
]
RandomiseOption = Annotated[
    str | None,
    typer.Option(
        metavar="EFFECT,…|all",
        help="Draw samples on arms with these effects, of other sizes and in other places; "
        "cablesense info --effects lists them.",
    ),
]


def dataset(
    context: typer.Context,
    out: Annotated[Path, typer.Option(help="The Parquet file to write.")],
    arm: ArmOption = "cdsm",
    protocol: Annotated[
        str,
        typer.Option(
            metavar="single|multi|anywhere",
            help="single: at most one contact, every segment, direction and force covered evenly. "
            "multi: none to all segments touched at once. anywhere: none, one or two, anywhere "
            "along the segments, with a force along them too.",
        ),
    ] = "single",
    samples: Annotated[int, typer.Option(help="How many samples.")] = 5000,
    pose: PoseOption = "straight",
    pose_range_deg: PoseRangeOption = None,
    force_low_n: Annotated[float, typer.Option(help="Weakest contact force, N.")] = 0.0,
    force_high_n: Annotated[
        float | None,
        typer.Option(
            help="Strongest contact force, N.",
            show_default="200; 60 for multi; less on a weak arm",
        ),
    ] = None,
    no_contact_fraction: Annotated[
        float | None,
        typer.Option(help="Share of contact-free samples.", show_default="1 / (segments + 1)"),
    ] = None,
    max_contacts: Annotated[
        int | None, typer.Option(help="multi: most contacts at once.", show_default="all segments")
    ] = None,
    two_contacts_fraction: Annotated[
        float | None,
        typer.Option(
            help="anywhere: share of touched samples with two contacts.", show_default="0.15"
        ),
    ] = None,
    axial_share: Annotated[
        float | None,
        typer.Option(
            help="anywhere: largest force along the segment, as a share of that normal to it.",
            show_default="0.3",
        ),
    ] = None,
    noise: Annotated[
        bool, typer.Option(help="Apply the arm file's sensor noise and step, or read exactly.")
    ] = True,
    randomise: RandomiseOption = None,
    tare_samples: Annotated[
        int, typer.Option(help="Unloaded readings averaged into each sample's tare.")
    ] = 50,
    seed: Annotated[int, typer.Option(help="The same seed gives the same bytes.")] = 0,
    workers: Annotated[
        int, typer.Option(help="Processes to use; has no influence on the file.")
    ] = 1,
    dask_scheduler: DaskOption = None,
    force: ForceOption = False,
    json_output: JsonOption = False,
) -> None:
    """Generate training data: cable tensions of the simulated arm, with the contacts behind them.

    Each row is the difference that a contact makes to the cable tensions, with the contact as its
    label. Units, the arm and all options are stored in the file.

    Example: cablesense dataset --pose random --samples 20000 --workers 2 --out data.parquet
    """
    from cablesense_sim.arm import find_arm, load_arm
    from cablesense_training.data.parquet import produce_dataset
    from cablesense_training.data.protocols import protocol_from_options

    if pose == "straight":
        refuse_given(context, ["pose_range_deg"], "with --pose straight")
    if dask_scheduler is not None:
        refuse_given(context, ["workers"], "with --dask-scheduler")
    apart = ("out", "arm", "seed", "workers", "dask_scheduler", "force", "json_output")
    chosen = {k: v for k, v in context.params.items() if k not in apart and v is not None}
    chosen["kind"] = chosen.pop("protocol")
    arm_file = find_arm(arm)
    output_file(out, force=force, inputs=(arm_file,))
    description = load_arm(arm_file)
    drawn = protocol_from_options(chosen, description)
    # what cannot change a byte of the file is left out of its command
    options = drawn.options()
    if drawn.pose == "straight":
        del options["pose_range_deg"]
    command = {"arm": arm, "protocol": options.pop("kind"), **options, "seed": seed}
    started = time.perf_counter()
    summary = produce_dataset(
        out,
        description,
        drawn,
        seed,
        command=command_line("dataset", command),
        workers=workers,
        dask_scheduler=dask_scheduler,
        show_progress=True,
    )
    took_s = time.perf_counter() - started
    statistics = {"out": str(out), "arm": description.identity, **asdict(summary)}
    statistics["force_range_n"] = [statistics.pop("weakest_n"), statistics.pop("strongest_n")]
    statistics |= {"seconds": took_s, "rows_per_second": summary.rows / took_s}
    print_result("Dataset", statistics, json_output)


def train(
    context: typer.Context,
    arm: ArmOption = "cdsm",
    network: Annotated[
        str,
        typer.Option(
            help="The paper's networks, from tensions alone, of contacts at the contact points of "
            "the arm file. One contact: two-stage, shared-backbone, decoupled. Several at once: "
            "multi-contact."
        ),
    ] = "two-stage",
    data: Annotated[
        Path | None,
        typer.Option(help="Train on this file of cablesense dataset, not on fresh samples."),
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(help="How many fresh samples to draw.", show_default="the network's own"),
    ] = None,
    pose: PoseOption = "random",
    pose_range_deg: PoseRangeOption = None,
    force_high_n: Annotated[
        float | None,
        typer.Option(
            help="Strongest contact force, N.",
            show_default="200; 60 for several contacts; less on a weak arm",
        ),
    ] = None,
    randomise: RandomiseOption = None,
    epochs: Annotated[
        int | None, typer.Option(help="At most so many epochs.", show_default="the network's own")
    ] = None,
    batch_size: Annotated[
        int | None, typer.Option(help="Samples per step.", show_default="the network's own")
    ] = None,
    learning_rate: Annotated[
        float | None, typer.Option(help="Adam's, at the start.", show_default="the network's own")
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of samples, initial weights and their order.")
    ] = 0,
    threads: Annotated[
        int, typer.Option(help="Processor threads; another number changes the last digits.")
    ] = 2,
    out: Annotated[Path, typer.Option(help="The model file to write.")] = Path("model.onnx"),
    force: ForceOption = False,
    verbose: VerboseOption = False,
    json_output: JsonOption = False,
) -> None:
    """Train a network of the paper for an arm and write it as one ONNX file.

    Draws its own samples unless given a dataset, trains, and tests on samples it has never seen.
    The model file contains the arm and this command. The estimator that CableSense uses needs no
    training: [bold]cablesense export[/bold] makes it.

    Example: cablesense train --arm my_arm.yaml --network two-stage --out my_arm_two_stage.onnx
    """
    from dataclasses import replace

    from cablesense_sim.arm import find_arm, load_arm
    from cablesense_training import model_training
    from cablesense_training.data.parquet import read_dataset
    from cablesense_training.fit import EpochRecord

    if data is not None:
        drawing = ("samples", "pose", "pose_range_deg", "force_high_n", "randomise")
        refuse_given(context, drawing, "with --data, which draws no samples")
    elif pose == "straight":
        refuse_given(context, ["pose_range_deg"], "with --pose straight")
    recipe = model_training.recipe_for(network)
    chosen = {"epochs": epochs, "batch_size": batch_size, "learning_rate": learning_rate}
    overrides: dict[str, Any] = {k: value for k, value in chosen.items() if value is not None}
    settings = replace(recipe.settings, seed=seed, threads=threads, **overrides)
    drawn = {
        "samples": recipe.samples if samples is None else samples,
        "pose": pose,
        "pose_range_deg": pose_range_deg,
        "force_high_n": force_high_n,
        "randomise": randomise,
    }
    command = {"arm": arm, "network": network, **(drawn if data is None else {"data": data})}
    command |= {name: getattr(settings, name) for name in chosen}
    command |= {"seed": seed, "threads": threads, "out": out}
    arm_file = find_arm(arm)
    output_file(out, force=force, inputs=(arm_file, data))
    description = load_arm(arm_file)
    if data is None:
        training = model_training.draw_training_data(
            description, network, drawn, seed, show_progress=True
        )
    else:
        training = read_dataset(data, description)
    with progress_bar(settings.epochs, what="epochs") as advance:

        def on_epoch(record: EpochRecord) -> None:
            advance(1, f"loss {record.total:.4f}, held out {record.validation:.4f}")

        report = model_training.train_model(
            out,
            network,
            training,
            settings,
            command=command_line("train", command),
            on_epoch=on_epoch,
        )
    content = report.as_json()
    title = f"{network}, arm {description.identity}"
    print_summary(title, training_lines(content), content, as_json=json_output, verbose=verbose)


def command_line(verb: str, options: Mapping[str, Any]) -> str:
    """The command that makes a file again, from the verb's options by their Python names.

    None is left out, and an absolute folder of the output, which means nothing elsewhere.
    """
    parts = ["cablesense", verb]
    for name, value in options.items():
        option = name.replace("_", "-")
        if isinstance(value, bool):
            parts.append(f"--{option}" if value else f"--no-{option}")
        elif name == "out" and Path(value).is_absolute():
            parts += [f"--{option}", Path(value).name]
        elif value is not None:
            parts += [f"--{option}", f"{value}"]
    return shlex.join(parts)
