"""`cablesense info`: what an arm file or a model file says, and which effects an arm can have."""

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
    effects: Annotated[
        bool,
        typer.Option(
            "--effects", help="Show the catalogue of effects that an arm file can list instead."
        ),
    ] = False,
    json_output: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Show what an arm or a model is: geometry, cables, sensors; or inputs, outputs, training.

    With --effects: what real arms do beyond the ideal, with places, parameters and sources.

    Examples: [bold]cablesense info cdsm[/bold], [bold]cablesense info my_arm.yaml --json[/bold],
    [bold]cablesense info config/models/cdsm.onnx[/bold], [bold]cablesense info --effects[/bold]
    """
    import json

    from rich.console import Console

    from cablesense_ros.cli.description import describe_arm, describe_model, description_tables
    from cablesense_ros.cli.effect_catalogue import describe_effects, effect_tables

    if effects:
        description = describe_effects()
        tables = effect_tables(description)
    else:
        description = describe_model(file) if file.endswith(".onnx") else describe_arm(file)
        tables = description_tables(description)
    if json_output:
        print(json.dumps(description, indent=2))
        return
    console = Console()
    for table in tables:
        console.print(table)
