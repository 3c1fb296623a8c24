"""`cablesense gap protocol`: what to do with the arm while it is recorded."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from cablesense_gap.recordings.block import Block


def protocol(
    arm: Annotated[str, typer.Option(help="A bundled arm's name, or an arm file.")] = "cdsm",
    out: Annotated[
        Path | None,
        typer.Option(help="Also write commands and loads as rows of a recording, .csv."),
    ] = None,
) -> None:
    """Print which poses, loads and holds to record, so that effects can be told apart.

    Loads leave every cable of the nominal arm taut. Each block is one trial; take longer where
    hands need it, and keep the order.

    Example: cablesense gap protocol --arm my_arm.yaml --out protocol.csv
    """
    from rich.console import Console

    from cablesense_gap.recordings.protocol import protocol_rows, standard_protocol
    from cablesense_sim.arm_files import open_arm

    description = open_arm(arm)
    blocks = standard_protocol(description)
    console = Console()
    console.print(_table(blocks, f"Protocol for arm {description.name}"))
    console.print(
        "Sides as seen along the arm from its base. Record with: cablesense gap record "
        "--out recording.mcap",
        style="dim",
    )
    if out is not None:
        import numpy as np

        from cablesense_gap.recordings.csv_file import write_csv
        from cablesense_gap.recordings.recording import Recording

        rows = protocol_rows(description, blocks)
        write_csv(out, Recording(out.stem, *rows, tensions_n=np.empty((len(rows.time_s), 0))))
        console.print(f"{out}: {len(rows.time_s):,} rows, {rows.time_s[-1]:.0f} s")


def _table(blocks: tuple[Block, ...], title: str) -> Table:
    from rich.table import Table

    table = Table(title=title, title_justify="left", header_style="bold")
    table.add_column("trial", justify="right")
    table.add_column("at, s", justify="right")
    table.add_column("takes, s", justify="right")
    table.add_column("what", no_wrap=True)
    table.add_column("what to do")
    at_s = 0.0
    for number, block in enumerate(blocks):
        table.add_row(
            str(number), f"{at_s:.0f}", f"{block.duration_s:.0f}", str(block.kind), block.does
        )
        at_s += block.duration_s
    return table
