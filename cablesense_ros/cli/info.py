"""`cablesense info`: what an arm file or a model file says."""

from __future__ import annotations

from typing import Annotated

import typer


def info(
    file: Annotated[
        str,
        typer.Argument(
            help="An arm file (.yaml) or a model file (.onnx): a path, or a bundled arm's name."
        ),
    ] = "cdsm",
    json_output: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Show what an arm or a model is: geometry, cables, sensors; or inputs, outputs, training.

    Examples: [bold]cablesense info cdsm[/bold], [bold]cablesense info my_arm.yaml --json[/bold],
    [bold]cablesense info config/models/cdsm.onnx[/bold]
    """
    import json

    from rich.console import Console

    from cablesense_ros.cli.description import describe_arm, describe_model, description_tables

    description = describe_model(file) if file.endswith(".onnx") else describe_arm(file)
    if json_output:
        print(json.dumps(description, indent=2))
        return
    console = Console()
    for table in description_tables(description):
        console.print(table)
