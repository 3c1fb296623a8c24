"""`cablesense dataset`: draw contacts by a protocol and write the tensions that they cause."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from cablesense_base.files import output_file
from cablesense_ros.cli.options import (
    ArmOption,
    ForceOption,
    JsonOption,
    PoseOption,
    PoseRangeOption,
    RandomiseOption,
    command_line,
    refuse_given,
)
from cablesense_ros.cli.results import print_result


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
    dask_scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Run on this Dask cluster instead.")
    ] = None,
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
    chosen = {
        "kind": protocol,
        "samples": samples,
        "pose": pose,
        "pose_range_deg": pose_range_deg,
        "noise": noise,
        "tare_samples": tare_samples,
        "force_low_n": force_low_n,
        "force_high_n": force_high_n,
        "no_contact_fraction": no_contact_fraction,
        "max_contacts": max_contacts,
        "two_contacts_fraction": two_contacts_fraction,
        "axial_share": axial_share,
        "randomise": randomise,
    }
    arm_file = find_arm(arm)
    output_file(out, force=force, inputs=(arm_file,))
    description = load_arm(arm_file)
    drawn = protocol_from_options({k: v for k, v in chosen.items() if v is not None}, description)
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
        show_progress=not json_output,
    )
    took_s = time.perf_counter() - started
    statistics = {"out": str(out), "arm": description.identity, **asdict(summary)}
    statistics["force_range_n"] = [statistics.pop("weakest_n"), statistics.pop("strongest_n")]
    statistics |= {"seconds": took_s, "rows_per_second": summary.rows / took_s}
    print_result("Dataset", statistics, json_output)
