"""`cablesense dataset`: draw contacts after a protocol and write what the cables would say."""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from cablesense_base.errors import CableSenseError
from cablesense_cli.options import refuse_given


def dataset(
    context: typer.Context,
    out: Annotated[Path, typer.Option(help="The Parquet file to write.")],
    arm: Annotated[str, typer.Option(help="A bundled arm's name, or an arm file.")] = "cdsm",
    protocol: Annotated[
        str,
        typer.Option(
            metavar="single|multi",
            help="single: at most one contact, every segment, direction and force covered evenly. "
            "multi: none to all segments touched at once.",
        ),
    ] = "single",
    samples: Annotated[int, typer.Option(help="How many samples.")] = 5000,
    pose: Annotated[
        str,
        typer.Option(metavar="straight|random", help="The arm straight, or at random poses."),
    ] = "straight",
    pose_range_deg: Annotated[
        float, typer.Option(help="Random poses: joint angles within plus or minus this.")
    ] = 10.0,
    force_low_n: Annotated[float, typer.Option(help="Weakest contact force, N.")] = 0.0,
    force_high_n: Annotated[
        float | None,
        typer.Option(help="Strongest contact force, N.", show_default="200; 60 for multi"),
    ] = None,
    no_contact_fraction: Annotated[
        float | None,
        typer.Option(help="Share of contact-free samples.", show_default="1 / (segments + 1)"),
    ] = None,
    max_contacts: Annotated[
        int | None,
        typer.Option(help="multi: most contacts at once.", show_default="all segments"),
    ] = None,
    noise: Annotated[
        bool, typer.Option(help="Apply the arm file's sensor noise and step, or read exactly.")
    ] = True,
    randomise: Annotated[
        str | None,
        typer.Option(
            metavar="EFFECT,…|all",
            help="Draw samples on arms with these effects, of other sizes and in other places; "
            "cablesense info --effects lists them.",
        ),
    ] = None,
    tare_samples: Annotated[
        int, typer.Option(help="Unloaded readings averaged into each sample's tare.")
    ] = 50,
    seed: Annotated[int, typer.Option(help="The same seed gives the same bytes.")] = 0,
    workers: Annotated[
        int, typer.Option(help="Processes to use; has no influence on the file.")
    ] = 1,
    dask_scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Run on this Dask cluster instead."),
    ] = None,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print the statistics as JSON.")
    ] = False,
) -> None:
    """Generate training data: cable tensions of the simulated arm, with the contacts behind them.

    Each row is the difference that a contact makes to the cable tensions, with the contact as its
    label. Units, the arm and all options are stored in the file.

    Example: cablesense dataset --pose random --samples 20000 --workers 2 --out data.parquet
    """
    from cablesense_sim.arm import open_arm

    try:
        from cablesense_training.data.parquet import produce_dataset
        from cablesense_training.data.protocols import protocol_from_options
    except ModuleNotFoundError as error:
        raise CableSenseError(
            f"datasets need {error.name}; install it with: pip install 'cablesense_ros[train]'"
        ) from error

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
        "randomise": randomise,
    }
    drawn = protocol_from_options({k: v for k, v in chosen.items() if v is not None})
    description = open_arm(arm)
    started = time.perf_counter()
    summary = produce_dataset(
        out,
        description,
        drawn,
        seed,
        command=dataset_command(arm, drawn.options(), seed),
        workers=workers,
        dask_scheduler=dask_scheduler,
        show_progress=not json_output,
    )
    took_s = time.perf_counter() - started
    statistics = asdict(summary)
    force_range_n = [statistics.pop("weakest_n"), statistics.pop("strongest_n")]
    statistics = {
        "out": str(out),
        "arm": description.identity,
        **statistics,
        "force_range_n": force_range_n,
        "seconds": took_s,
        "rows_per_second": summary.rows / took_s,
    }
    if json_output:
        typer.echo(json.dumps(statistics))
    else:
        _print_table(statistics)


def dataset_command(arm: str, protocol_options: Mapping[str, Any], seed: int) -> str:
    """The command that makes the dataset; what cannot change a byte of it is left out."""
    options = dict(protocol_options)
    options = {"arm": arm, "protocol": options.pop("kind"), **options, "seed": seed}
    return command_line("dataset", options)


def command_line(verb: str, options: Mapping[str, Any]) -> str:
    """The command that makes a file again, from the verb's options by their Python names.

    Options left to their default of None are left out. A folder outside the present one is left
    out of the output's name, as it means nothing elsewhere.
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


def _print_table(statistics: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    weakest, strongest = statistics["force_range_n"]
    segments = enumerate(statistics["contacts_per_segment"], start=1)
    table = Table(title=f"{statistics['out']}, arm {statistics['arm']}", show_header=False)
    for label, text in (
        ("samples", f"{statistics['rows']:,}"),
        ("without contact", f"{statistics['contact_free']:,}"),
        *((f"contacts on segment {number}", f"{count:,}") for number, count in segments),
        ("contact forces", f"{weakest:.3g} to {strongest:.4g} N"),
        ("with slack cables", f"{statistics['slack_rows']:,}"),
        ("drawn again (beyond the arm)", f"{statistics['redrawn_rows']:,}"),
        (
            "rate",
            f"{statistics['rows_per_second']:,.0f} samples/s, {statistics['seconds']:.1f} s",
        ),
    ):
        table.add_row(label, text)
    Console().print(table)
